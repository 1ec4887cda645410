"""Net files: YAML or PNML to nets, with file, line, column and the nearest right name in complaints.

A file is read to values with positions (:mod:`im_core.text.yamltext`), put together (:mod:`~im_pnt.netfile.templates`),
checked by the models of :mod:`~im_pnt.netfile.schema`, and made a net by :mod:`~im_pnt.netfile.reader`;
:mod:`~im_pnt.netfile.writer` writes one.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from im_pnt.errors import MissingPartsError
from im_pnt.model.net import Net
from im_pnt.netfile.reader import read_net
from im_pnt.netfile.schema.net import schema_text
from im_pnt.netfile.templates import assemble
from im_pnt.netfile.text import read_text, read_values
from im_pnt.netfile.writer import describe, yaml_text

__all__ = ["PNML_SUFFIXES", "describe", "load_net", "load_present", "parse_net", "schema_text", "yaml_text"]

PNML_SUFFIXES = (".pnml", ".xml", ".tapn")


def load_net(path: str | Path, within: Sequence[Path] = ()) -> Net:
    """Read a net file.

    Args:
        path: File with one net: PNML as ``.pnml``, ``.xml``, ``.tapn``, else YAML; ``FILE#net`` is one of several.
        within: Folders that this file and those that it includes must lie in; empty: they may lie anywhere.

    Returns:
        The net; its names are consistent, its behaviour is not verified.

    Raises:
        NetFileError: The file is not a net; names file, line, column and what is allowed.

    >>> load_net("nowhere.yaml")
    Traceback (most recent call last):
    im_pnt.errors.NetFileError: nowhere.yaml:1: cannot be read: No such file or directory
    """
    file = Path(path)
    named = file if file.exists() else Path(file.name.partition("#")[0])  # FILE.pnml#net
    if named.suffix.lower() in PNML_SUFFIXES:
        from im_pnt.pnml import load_pnml

        return load_pnml(file, within)
    return read_net(assemble(read_values(read_text(file, within), str(file)), file, within))


def load_present(paths: Iterable[Path]) -> tuple[list[Net], dict[str, str]]:
    """Read the net files with all needed parts present in the cell.

    Returns:
        The nets, and the reason against each left out, by name of the file.

    Raises:
        NetFileError: A file is not a net.
    """
    nets, left_out = [], {}
    for path in paths:
        try:
            nets.append(load_net(path))
        except MissingPartsError as error:
            left_out[path.stem] = error.message
    return nets, left_out


def parse_net(
    text: str,
    source: str = "net",
    file: Path | None = None,
    within: Sequence[Path] = (),
    sent: Mapping[str, str] | None = None,
) -> Net:
    """Read a net from YAML text, as :func:`load_net` does from a file.

    Args:
        text: The text.
        source: Its name in messages.
        file: Where it belongs, so that it can include other files; None: it can include none.
        within: Folders that included files must lie in; empty: they may lie anywhere.
        sent: Texts of the files that came with the net, by the path from its folder; only others are read. None: the
            net was not sent.

    Raises:
        NetFileError: The text is not a net.

    >>> parse_net("{net: oven, places: {cold: 1}, transitions: {bake: {in: [cld], out: [cold]}}}")
    Traceback (most recent call last):
    im_pnt.errors.NetFileError: net:1:58: transitions.bake.in[0]: there is no place 'cld' (did you mean 'cold'?)
    """
    return read_net(assemble(read_values(text, source), file, within, sent))
