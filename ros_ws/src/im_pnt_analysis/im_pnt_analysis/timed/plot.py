"""Drawings of expected times."""

import io
from pathlib import Path
from typing import Any

from im_core.errors import ImError
from im_core.files import write_whole
from im_pnt_analysis.recorded.firings import Mission
from im_pnt_analysis.timed.durations import CommandDuration
from im_pnt_analysis.timed.measurement import Comparison
from im_pnt_analysis.timed.steady import SteadyState

_BARS = 40
_EXPECTED, _TOTAL, _MEASURED = "#2b6cb0", "#bcd3ea", "#dd8833"


def plot_command(expected: CommandDuration, comparison: Comparison | None, output: Path) -> None:
    """Draw a bar for each action: the time, the critical part, and the measured time.

    Args:
        expected: What was computed.
        comparison: What was measured; None: nothing.
        output: File to write, ``.svg`` or ``.png``.

    Raises:
        ImError: The file cannot be written.
    """
    actions = [action for action in expected.actions if action.mean > 0.0][:_BARS]
    figure, axes = _figure(len(actions))
    rows = range(len(actions))
    axes.barh(rows, [a.firings * a.mean for a in actions], height=0.7, color=_TOTAL, label="expected time")
    axes.barh(rows, [a.critical for a in actions], height=0.7, color=_EXPECTED, label="of it critical")
    if comparison is not None:
        spent = {row.transition: row.measured_firings * (row.measured_mean or 0.0) for row in comparison.actions}
        prefix = "" if len(expected.nets) > 1 else f"{expected.nets[0]}."
        measured = [spent.get(f"{prefix}{action.transition}", 0.0) for action in actions]
        axes.plot(measured, rows, "d", color=_MEASURED, label="measured time")
    axes.set_yticks(rows, [action.transition for action in actions])
    axes.set_xlabel("time in one command [s]")
    low, _, high = expected.quantiles
    title = f"{expected.symbol}: {expected.mean:.4g} s expected (5 to 95 %: {low:.4g} to {high:.4g} s)"
    if comparison is not None and comparison.measured is not None:
        title += f", {comparison.measured:.4g} s measured"
    axes.set_title(title)
    axes.legend(loc="lower right")
    _write(figure, output)


def plot_steady(name: str, state: SteadyState, output: Path) -> None:
    """Draw a bar for each place and transition: the share of marked or busy time.

    Args:
        name: Name of the nets.
        state: Their steady state.
        output: File to write, ``.svg`` or ``.png``.

    Raises:
        ImError: The file cannot be written.
    """
    bars = [(transition, float(share), _EXPECTED) for transition, share in state.busy.items()]
    bars += [(place, float(share), _TOTAL) for place, share in state.marked.items() if share]
    bars = bars[:_BARS]
    figure, axes = _figure(len(bars))
    rows = range(len(bars))
    axes.barh(rows, [share for _, share, _ in bars], height=0.7, color=[color for _, _, color in bars])
    axes.set_yticks(rows, [label for label, _, _ in bars])
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of the time busy (transitions, dark) or marked (places, light)")
    axes.set_title(name)
    _write(figure, output)


def plot_mission(mission: Mission, output: Path) -> None:
    """Draw a row for each transition with a duration or failure, and a bar for each of the firings.

    Args:
        mission: What fired.
        output: File to write, ``.svg`` or ``.png``.

    Raises:
        ImError: The file cannot be written.
    """
    bars = [firing for firing in mission.firings if firing.end_s is not None and firing.on_time_line]
    labels = list(dict.fromkeys(f"{firing.net}.{firing.transition}" for firing in bars))
    figure, axes = _figure(len(labels))
    for firing in bars:
        row, length = labels.index(f"{firing.net}.{firing.transition}"), (firing.end_s or 0.0) - firing.begin_s
        colour = _MEASURED if firing.failed else _EXPECTED
        axes.barh(row, length, left=firing.begin_s, height=0.7, color=colour, edgecolor=colour)  # 0 s show, too
    axes.set_yticks(range(len(labels)), labels)
    axes.set_xlabel("testbed time [s]; failed firings are light")
    _write(figure, output)


def _figure(rows: int) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 1.6 + 0.32 * max(rows, 1)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.invert_yaxis()
    return figure, axes


def _write(figure: Any, output: Path) -> None:
    drawing = io.BytesIO()
    figure.savefig(drawing, format=output.suffix.removeprefix("."), dpi=120)
    try:
        write_whole(output, drawing.getvalue())
    except OSError as error:
        raise ImError(f"cannot write '{output}': {error.strerror}", code="input") from error
