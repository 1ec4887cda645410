"""Net files: YAML or PNML to nets, with complaints that name file, line, column and the nearest right name."""

from pathlib import Path

from im_pnt.net import Net
from im_pnt.netfile.assemble import assemble
from im_pnt.netfile.node import Node
from im_pnt.netfile.reader import read_net
from im_pnt.netfile.source import read_text
from im_pnt.netfile.yamltext import read_yaml

PNML_SUFFIXES = (".pnml", ".xml")


def load_net(path: str | Path) -> Net:
    """Reads a net file.

    Args:
        path: File with one net: PNML where it ends in ``.pnml`` or ``.xml``, else YAML.

    Returns:
        The net; its names are consistent, its behaviour is not verified.

    Raises:
        NetFileError: The file is not a net; names file, line, column and what is allowed.
    """
    file = Path(path)
    if file.suffix.lower().partition("#")[0] in PNML_SUFFIXES:
        from im_pnt.pnml import load_pnml

        return load_pnml(file)
    root = Node(read_yaml(read_text(file), str(file)))
    return read_net(assemble(root, file))


def parse_net(text: str, source: str = "net") -> Net:
    """Reads a net from YAML text, as :func:`load_net` does from a file; it can include no other file.

    Raises:
        NetFileError: The text is not a net.
    """
    return read_net(assemble(Node(read_yaml(text, source)), None))
