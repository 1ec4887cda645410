"""The page of the documentation that shows the latest run, its history and the drawing of it."""

from pathlib import Path

from bench.page import history
from bench.page.run import Run, markdown
from im_core.files import FileError, read_text, write_whole

BEGIN, END = "<!-- bench: what follows is written by scripts/bench.sh --docs -->", "<!-- bench: end -->"
PAGE, HISTORY, DRAWING = "performance.md", "performance.json", "images/performance.svg"


def document(made: Run, past: history.History, docs: Path) -> None:
    """Shows a run in ``performance.md`` between its marks, and adds it to history and drawing.

    Raises:
        FileError: The page is not there, or lacks its marks.
    """
    page = docs / PAGE
    text = filled(page, read_text(page), markdown(made))
    grown = history.with_run(past, made)
    lacking = [followed.label for followed in history.FOLLOWED if followed.value(made) is None]
    if lacking:
        print(f"bench: followed, but not measured in this run: {'; '.join(lacking)}")
    for path in (
        history.write(grown, docs / HISTORY),
        history.draw(grown, docs / DRAWING),
        write_whole(page, text),
    ):
        print(f"bench: {path}")


def filled(page: Path, text: str, content: str) -> str:
    """A page with other contents between its marks.

    Raises:
        FileError: It lacks them.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise FileError(page, f"lacks the lines '{BEGIN}' and '{END}', between which the figures go")
    return f"{before}{BEGIN}\n\n{content}\n{END}{after}"
