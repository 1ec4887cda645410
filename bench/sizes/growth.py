"""Rows of one quantity over growing sizes."""

from collections.abc import Mapping

from bench.figures import Line


def growth(what: str, values: Mapping[int, float], unit: str, size: str, linear: bool = True) -> list[Line]:
    """A row for each size, against what the smallest would come to if the cost grew as the size does.

    Args:
        what: What is measured.
        values: By size.
        unit: Of the values.
        size: What the size counts, e.g. ``poses``.
        linear: Whether the baseline grows with the size; else it is the value of the smallest.
    """
    least = min(values)
    return [
        Line(
            f"{what}, {_counted(number, size)}",
            value,
            unit,
            None if number == least else values[least] * (number / least if linear else 1.0),
            "" if number == least else _counted(least, size) + (", in proportion" if linear else ""),
        )
        for number, value in sorted(values.items())
    ]


def _counted(number: int, size: str) -> str:
    return f"{number:,} {size.removesuffix('s') if number == 1 else size}"
