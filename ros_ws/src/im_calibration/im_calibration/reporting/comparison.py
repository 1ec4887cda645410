"""Comparison of two calibration reports of the same cameras: same result, or a list of changes."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from im_cell.camera_model import CameraModel
from im_cell.lens import lens_of

SAME = 1e-9
"""Largest relative difference of numbers that are the same."""


def largest_difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[float, str]:
    """Return the largest relative difference of numbers in two reports, and the place; infinite if other data differ.

    Numbers of a list count relative to the largest of it. What only one report has, of another version, is passed over.

    >>> largest_difference({"cameras": [{"rms_px": 0.25}]}, {"cameras": [{"rms_px": 0.5}]})
    (0.5, 'cameras[0].rms_px')
    """
    return max(_differences(old, new, ""), default=(0.0, ""))


def _differences(old: Any, new: Any, where: str) -> Iterator[tuple[float, str]]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in old.keys() & new.keys():
            yield from _differences(old[key], new[key], f"{where}.{key}" if where else str(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        with suppress(ValueError, TypeError):  # names, or numbers with holes: one by one
            first, second = np.array(old, dtype=float), np.array(new, dtype=float)
            if first.size and first.shape == second.shape and np.isfinite([first, second]).all():
                scale = max(np.abs(first).max(), np.abs(second).max())
                yield (float(np.abs(first - second).max() / scale) if scale else 0.0), where
                return
        for i, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from _differences(one, other, f"{where}[{i}]")
    elif _is_number(old) and _is_number(new):
        scale = max(abs(old), abs(new))
        yield (abs(old - new) / scale if scale else 0.0), where
    elif old != new:
        yield float("inf"), where


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def comparison(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Return a table of the recorded and the new result; a value missing in one result is ``-`` there."""
    rows: list[tuple[str, float | None, float | None, float | None]] = []
    was = {each["name"]: each for each in old["cameras"]}
    now = {each["name"]: each for each in new["cameras"]}
    for name in [*was, *(name for name in now if name not in was)]:
        first, second = (_values(each.get(name)) for each in (was, now))
        for key in [*first, *(key for key in second if key not in first)]:
            (one, deviation), (other, new_deviation) = first.get(key, (None, None)), second.get(key, (None, None))
            rows.append((f"{name} {key}", one, other, deviation if deviation is not None else new_deviation))
    deviations = old["led_offset_standard_deviation_m"]
    rows += [
        (f"light {axis} [mm]", 1e3 * one, 1e3 * other, 1e3 * sd)
        for axis, one, other, sd in zip("xyz", old["led_offset_m"], new["led_offset_m"], deviations, strict=True)
    ]
    rows.append(("chi2 / dof", old["chi2_per_dof"], new["chi2_per_dof"], None))
    rows.append(("poses used", old["points_used"], new["points_used"], None))
    for key, unit in (("triangulation_mm", "mm"), ("reprojection_px", "px")):
        name = f"expected {key.partition('_')[0]} [{unit}]"
        rows.append((name, old["expected_error"][key], new["expected_error"][key], None))
    width = max(len(row[0]) for row in rows)
    head = f"{'':{width}} {'recorded':>14} {'again':>14} {'difference':>11} {'known to':>10}"
    return [head, *(_row(width, *row) for row in rows)]


def _row(width: int, name: str, one: float | None, other: float | None, deviation: float | None) -> str:
    both = f"{other - one:11.3g}" if one is not None and other is not None else f"{'-':>11}"
    texts = [f"{'-':>14}" if value is None else f"{value:14.7g}" for value in (one, other)]
    return f"{name:{width}} {texts[0]} {texts[1]} {both} " + ("" if deviation is None else f"{deviation:10.2g}")


def _values(camera: Mapping[str, Any] | None) -> dict[str, tuple[float | None, float | None]]:
    """Return the values and standard deviations of a camera in a report, by names including the unit."""
    if camera is None:
        return {}
    sd, K, model = camera["standard_deviations"], np.array(camera["K"]), str(camera["distortion_model"])
    lens = lens_of(model)
    values = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    found: dict[str, tuple[float | None, float | None]] = {f"{n} [px]": (float(v), sd[n]) for n, v in values.items()}
    terms = dict(zip(lens.coefficients[: lens.estimated], camera["D"], strict=False))
    prefix = "" if model == "plumb_bob" else f"{model} "
    found |= {f"{prefix}{name}": (value, sd[name]) for name, value in terms.items()}
    R, t = np.array(camera["R_cam_base"]), np.array(camera["t_cam_base_m"])
    where = CameraModel(int(camera["width"]), int(camera["height"]), K, np.array(camera["D"]), R, t, model).position
    found |= {f"stands at {axis} [mm]": (1e3 * float(value), None) for axis, value in zip("xyz", where, strict=True)}
    found["residuals [px]"] = (camera["rms_px"], None)
    found["spots used"] = (camera["spots_used"], None)
    return found
