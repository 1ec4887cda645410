"""Picture of a recorded mission: its firings over time."""

import io
from pathlib import Path
from typing import Any

from im_core.errors import ImError
from im_core.files import write_whole
from im_pnt_analysis.recorded.firings import Mission

_DONE, _FAILED = "#2b6cb0", "#dd8833"


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
        colour = _FAILED if firing.failed else _DONE
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
