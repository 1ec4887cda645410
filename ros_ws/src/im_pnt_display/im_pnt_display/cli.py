"""``pnt draw``: draws a net."""

import argparse
from pathlib import Path

from im_core.errors import ImError
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, write_output
from im_pnt_display.drawing.draw import dot, draw, svg


def add(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Adds the command to the parser."""
    parser = commands.add_parser("draw", help="draw a net", description="Draws a net file.")
    parser.set_defaults(run=run)
    parser.add_argument("file", metavar="FILE", help="net file")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="file to write, .svg or .dot")
    parser.add_argument("--phases", action="store_true", help="draw start, active, end and failed of timed transitions")


def run(options: argparse.Namespace) -> int:
    """Draws a net file."""
    output = Path(options.output)
    if output.suffix not in (".svg", ".dot"):
        raise ImError(f"cannot draw into '{output}': the name must end in .svg or .dot", code="input")
    drawing = draw(load_net(options.file), phases=options.phases)
    write_output(output, svg(drawing) if output.suffix == ".svg" else dot(drawing), overwrite=True)
    print(f"{output}: {len(drawing.nodes)} nodes, {len(drawing.arcs)} arcs")
    return OK
