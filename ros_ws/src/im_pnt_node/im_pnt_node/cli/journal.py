"""``pnt journal``: show the memory of a node after a restart, and delete the memory."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

from im_core.errors import NotFoundError
from im_core.names import run_dir
from im_core.options import at_least
from im_pnt_node.journal.folder import LOCK, Folder
from im_pnt_node.journal.log import Recovered, discard, look

_DESCRIPTION = """Looks into the journals of nodes that run nets, and moves them aside.

A node writes each event and each firing into its journal before anything follows from it; after kill -9 it comes back
with what is there. A journal belongs to one mission of the machine: scripts/start.sh goes on with one whose commands
had not ended, or whose machine died, or begins with new journals and keeps those of the last five missions, with their
data objects, in .run/im<domain>/missions. A journal that is damaged its node sets aside by itself, in a folder
damaged-TIME beside it, and begins anew.

  scripts/im pnt journal show                      the journals of this machine
  scripts/im pnt journal show dispatcher           what is marked, what runs, and the last ten entries
  scripts/im pnt journal show old/dispatcher --entries 1000    of a copy, with more of them
  scripts/im pnt journal discard dispatcher        the node forgets: its next start begins anew

Exit code: 0 done, 2 there is no such journal, it is damaged (file, record and byte are named), or in use."""
_SHOW = """Shows what a journal holds; it is read only, also while its node writes it.

A journal begins with a snapshot, on which batches of entries follow. Entries of a net are its events and firings
(fire: a transition, or the begin of an action t.start; end: of an action); of the exchange what was delivered between
nets; of the link what was sent to other nodes (out), taken from them (in) and acknowledged."""
_DISCARD = """Moves a journal into a folder beside it, from where it can be brought back by hand; nothing is deleted.

The node that it belongs to must not run. When it starts again, the nodes that it had to do with notice that it has lost
its memory, say so, and give up what they had asked each other. Tokens that it held are as its nets begin."""
_WIDTH = 200


def add(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser of ``pnt``."""
    raw = argparse.RawDescriptionHelpFormatter
    about = "what does a node remember?"
    parser = commands.add_parser("journal", help=about, description=_DESCRIPTION, formatter_class=raw)
    commands = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    show = commands.add_parser("show", help="what does it hold?", description=_SHOW, formatter_class=raw)
    show.add_argument("journal", nargs="?", metavar="NODE", help="name of a node, or folder of a journal; none: all")
    show.add_argument("--entries", type=at_least(1), default=10, metavar="N", help="how many of the last (default: 10)")
    show.set_defaults(run=_show)
    forget = commands.add_parser("discard", help="move it aside", description=_DISCARD, formatter_class=raw)
    forget.add_argument("journal", metavar="NODE", help="name of a node, or folder of a journal")
    forget.set_defaults(run=_discard)


def _show(options: argparse.Namespace) -> int:
    if options.journal is not None:
        folder = _folder(options.journal)
        print("\n".join(described(_held(folder), options.entries)))
        return 0
    folders = _folders()
    for folder in folders:
        print(summary(_held(folder)))
    if not folders:
        print(f"there are no journals in {_home()}")
    return 0


def _discard(options: argparse.Namespace) -> int:
    folder = _folder(options.journal)
    aside = discard(Folder(folder))
    if aside is None:
        raise NotFoundError(kind="journal", name=options.journal, known=[each.name for each in _folders()])
    print(f"{folder}: the journal is now in {folder / aside}; the next start begins anew")
    return 0


def summary(held: Recovered) -> str:
    """Return a line about a journal: the node, the nets, and the size."""
    entries = sum(len(batch) for _, batch in held.batches)
    nets = held.header.get("nets")
    names = ", ".join(nets) if isinstance(nets, dict) else "none"
    torn = f"; its last record is torn ({held.torn} bytes) and will be dropped" if held.torn else ""
    return f"{held.header.get('node')}: nets {names}; {entries} entries since the snapshot, in {held.file}{torn}"


def described(held: Recovered, most: int) -> list[str]:
    """Return lines about a journal: the snapshot by net, and the last entries."""
    lines = [summary(held), "", "at the snapshot:"]
    nets, link = held.state.get("nets"), held.state.get("link")
    for name, net in nets.items() if isinstance(nets, dict) else ():
        lines.append(f"  net {name}: {_marking(net)}")
    for node, peer in link.get("peers", {}).items() if isinstance(link, dict) else ():
        waiting = len(peer.get("waiting", []))
        sent, taken = peer.get("last"), peer.get("heard", [0, 0])[1]
        lines.append(f"  link to {node}: {sent} messages sent, {waiting} of them not acknowledged; {taken} taken")
    if "store" in held.state:
        lines.append(f"  object store of /dom (identity:last transaction): {held.state['store']}")
    entries = [(record.number, entry) for record, batch in held.batches for entry in batch]
    last = entries[-most:]
    lines += ["", f"since then, the last {len(last)} of {len(entries)} entries (record, of what, entry):"]
    lines += [_line(number, entry) for number, entry in last]
    return lines


def _marking(net: Mapping[str, object]) -> str:
    places, running = net.get("places"), net.get("activities")
    marked = [
        f"{place}={tokens if isinstance(tokens, int) else len(tokens)}"
        for place, tokens in (places.items() if isinstance(places, dict) else ())
    ]
    acting = [f"{each[1]} ({each[2]})" for each in running] if isinstance(running, list) else []
    return f"{' '.join(marked) or 'nothing is marked'}; running: {', '.join(acting) or 'nothing'}"


def _line(number: int, entry: object) -> str:
    match entry:
        case ["net", str(net), content]:
            what = f"net {net}"
        case [str(what), content]:
            pass
        case _:
            what, content = "?", entry
    text = json.dumps(content)
    return f"  {number:>6}  {what:<24} {text if len(text) <= _WIDTH else f'{text[:_WIDTH]}...'}"


def _home() -> Path:
    return run_dir() / "journal"


def _folders() -> list[Path]:
    """Return the folders of the machine's journals, by name."""
    return _within(_home())


def _within(folder: Path) -> list[Path]:
    return sorted(lock.parent for lock in folder.glob(f"*/{LOCK}"))


def _folder(name: str) -> Path:
    """Find the folder of a journal.

    Raises:
        NotFoundError: There is none of that name; what is told is what a folder holds, or else this machine.
    """
    beside: list[str] = []
    if "\0" not in name:
        for folder in (_home() / name, Path(name)):
            if (folder / LOCK).is_file() or any(folder.glob("*.journal")):
                return folder
        beside = [str(each) for each in _within(Path(name))]
    raise NotFoundError(kind="journal", name=name, known=beside or [each.name for each in _folders()])


def _held(folder: Path) -> Recovered:
    held = look(Folder(folder))
    if held is None:
        raise NotFoundError(kind="journal", name=str(folder), known=[each.name for each in _folders()])
    return held
