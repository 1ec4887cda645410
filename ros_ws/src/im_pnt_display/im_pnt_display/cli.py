"""``im view``: opens the page. ``pnt draw``: draws a net. ``pnt display``: shows a recording on the page."""

import argparse
import os
import sys
import threading
import webbrowser
from pathlib import Path

from im_core.errors import ImError
from im_core.files import read_text
from im_core.names import display_file
from im_core.options import shown
from im_core.output import complain
from im_core.processes import host_record
from im_core.processes.end_signals import heed_end_signals
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, write_output
from im_pnt_display.drawing.draw import dot, draw, svg

_DISPLAY = """Shows the nets of a recording on the web page that shows those of a machine, with a time line to scroll
in: play, pause, step, and any moment at once. No machine is needed, and none is touched. Until Ctrl-C."""


def view() -> int:
    """Run ``im view``."""
    parser = argparse.ArgumentParser(
        prog="im view",
        description="Print the address of the machine's page, and open the page where this session has a screen. Where "
        "scripts/start.sh --control started the machine, the address has the token that lets the page operate it: a "
        "secret of yours. With BAG: the page over a recording, until Ctrl-C.",
        epilog="Exit codes: 0 shown, 1 the bag cannot be read, 2 bad usage, 3 no machine shows a page.",
    )
    parser.add_argument("bag", nargs="?", type=Path, metavar="BAG", help="folder of a bag, or a file of it")
    _add_address(parser)
    options = parser.parse_args()
    try:
        if options.bag is not None:
            return run_display(options)
        address = read_text(_address_file()).strip()
    except ImError as error:
        if options.bag is not None:
            complain(f"im view: {error.message}")
            return 1
        complain(f"im view: {_no_page()}")
        return 3
    print(address)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)
    return OK


def _address_file() -> Path:
    record = host_record.read()
    return Path(record.run_dir) / display_file().name if record is not None else display_file()


def _no_page() -> str:
    record = host_record.read()
    if record is not None:
        return f"host {record.host} serves no page; im tasks shows the host of pnt_display, where im view finds it"
    return "no machine shows a page here; scripts/start.sh starts one, im view BAG shows a recording"


def add(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("draw", help="draw a net", description="Draws a net file.")
    parser.set_defaults(run=run)
    parser.add_argument("file", metavar="FILE", help="net file")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="file to write, .svg or .dot")
    parser.add_argument("--all", action="store_true", help="draw the parts of subnets, otherwise one box each")
    parser.add_argument("--usual", action="store_true", help="leave out what follows failures and cancellations alone")
    parser.add_argument("--phases", action="store_true", help="draw start, active, end and failed of timed transitions")


def run(options: argparse.Namespace) -> int:
    """Draw a net file."""
    output = Path(options.output)
    if output.suffix not in (".svg", ".dot"):
        raise ImError(f"cannot draw into '{output}': the name must end in .svg or .dot", code="input")
    drawing = draw(load_net(options.file), phases=options.phases, usual=options.usual, subnets=options.all)
    write_output(output, svg(drawing) if output.suffix == ".svg" else dot(drawing), overwrite=True)
    print(f"{output}: {len(drawing.nodes)} nodes, {len(drawing.arcs)} arcs")
    return OK


def add_display(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("display", help="show the nets over a recording", description=_DISPLAY)
    parser.set_defaults(run=run_display)
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag, or a file of it")
    _add_address(parser)


def _add_address(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", help="of a bag: address to serve on, 0.0.0.0: all (default: %(default)s)"
    )
    parser.add_argument(
        "--port",
        type=_port,
        default=8080,
        help="of a bag: TCP port, the next free one if in use; 0: any (default: %(default)s)",
    )


def run_display(options: argparse.Namespace) -> int:
    """Show a recording until a signal asks to end."""
    from im_pnt_analysis.recorded.timeline import recording_of  # the libraries of bags and of web pages take a while
    from im_pnt_display.page.recorded_cell import RecordedCell
    from im_pnt_display.page.recording import RecordedNets
    from im_pnt_display.page.server import DisplayServer

    recording = recording_of(options.bag)
    ended = threading.Event()
    heed_end_signals(lambda _: ended.set())
    shown = RecordedNets(options.bag.resolve().name, recording, RecordedCell(options.bag))
    server = DisplayServer(options.host, options.port, recording=shown)
    server.start()
    try:
        moments = f"{recording.firings} firings in {recording.moments[-1].at_s:.1f} s"
        print(f"{options.bag}: {moments}, shown at {server.url}; Ctrl-C ends it", flush=True)
        ended.wait()
    finally:
        server.stop()
    return OK


def _port(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{shown(text)} is no TCP port, 0 to 65535")
    return int(text)


if __name__ == "__main__":
    sys.exit(view())
