"""The journal of a process: the nets, the exchange and the link, in one log, written before any effect leaves.

What happens is collected, and written as one batch before the next effect: before an action begins (:meth:`guard`) and
before messages, acknowledgements and answers leave (:meth:`commit`). A batch is written whole or not at all, so what a
message caused is never parted from its having been taken, nor a firing from the messages that it sends.
"""

import dataclasses
import enum
import functools
import hashlib
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from im_core import clock
from im_core.errors import ImError
from im_core.store_mark import SeenStore, StoreMark
from im_pnt.errors import DamagedJournalError, JournalError, NetError
from im_pnt.execution.actions import ActionOwner, Runner
from im_pnt.execution.functions import ActionContext, ActionFunction
from im_pnt.execution.jobs import Activity
from im_pnt.execution.journal_entries import EndFired, NetEntry, Record, TransitionFired
from im_pnt.execution.notification import Observer
from im_pnt.model.action import Action, RequestAction
from im_pnt.model.net import Net, ObjectScope
from im_pnt_node.distributed.codec import EXCHANGE_ENTRY, LINK_ENTRY, NET_ENTRY, encode_json
from im_pnt_node.distributed.entries import ExchangeEntry, LinkEntry
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.distributed.link import Link
from im_pnt_node.distributed.packets import new_epoch
from im_pnt_node.journal.folder import Files, Folder
from im_pnt_node.journal.log import DISCARD, MOST_BYTES, Log, Recovered, Sync, discard, set_aside
from im_pnt_node.journal.state import exchange_state, link_state, net_state, restore_exchange, restore_link, restore_net

COMPACT_BYTES = 8_000_000
COMPACT_SOON_BYTES, COMPACT_PERIOD_S = 256_000, 60.0
"""Above so many bytes a file is begun anew when it is so old: what is on the disk stays level soon, and a net that
fires as fast as it can does not wait for the disk all the time."""
_FIRINGS = frozenset((TransitionFired, EndFired))


class Journal:
    """Journal of one process; holds the folder until :meth:`close`.

    Args:
        files: The folder, by its path, or what stands for one.
        node: Name of the process.
        sync: When a record counts as written.
        compact_bytes: Size of the file above which a new one is begun with a snapshot, however young it is [bytes].
        observer: Is told of what was not written whole at the end, and of a journal that was set aside.
        run: Name of the run of the machine; with another name somebody has started it anew.
        store: The object store as the process has seen it; its mark is remembered with what happens.

    Attributes:
        of_this_run: Whether the journal that was found, if any, was written in this run of the machine.
        found: Nets in the journal that was found, with the files they came from, and their fingerprints; empty if there
            was none.
        epoch: Incarnation of the process, for its exchange and its link.
        lost: Why what was journalled is forgotten, a clause; empty if it is not.

    Raises:
        JournalError: Another process uses it, it cannot be read, or it belongs to another node.
    """

    def __init__(
        self,
        files: Files | Path,
        node: str,
        *,
        sync: Sync = Sync.OS,
        compact_bytes: int = COMPACT_BYTES,
        observer: Observer | None = None,
        run: str = "",
        store: SeenStore | None = None,
    ) -> None:
        self._run, self.of_this_run = run, True
        self._files = Folder(files) if isinstance(files, Path) else files
        self._node, self._compact_bytes, self._observer = node, compact_bytes, observer or Observer()
        self._sync = sync
        self._exchange: Exchange | None = None
        self._link: Link | None = None
        self._entries: list[str] = []
        self._outdated = False
        self._store = store or SeenStore()
        self._mark: StoreMark | None = None
        self._described: dict[str, tuple[Net, dict[str, str]]] = {}
        self._compact_at = self._compact_soon = compact_bytes
        self._compacted_at = clock.monotonic()
        self.epoch = new_epoch()
        self.found: dict[str, tuple[str, str]] = {}
        self.lost = ""
        self._files.lock()
        try:
            self._log = Log(self._files, sync)
            self._recovered = self._recover()
            if self._recovered is not None:
                self._look_at(self._recovered)
        except JournalError:
            self._files.unlock()
            raise

    # What the nets, the exchange and the link of the process need to be given.

    def recorder(self, net: str, told: Callable[[str], None] = lambda _: None) -> Record:
        """Return the recorder of events and firings for an executor."""
        begin, encode, append = f'["net",{encode_json(net)},', NET_ENTRY.encode, self._entries.append

        def record(entry: NetEntry) -> None:
            text = f"{begin}{encode(entry)}]"
            append(text)
            told(text)
            if type(entry) not in _FIRINGS and self._exchange is not None:
                self._exchange.inboxes.deliveries.taken(net, entry)

        return record

    def guard(self, runner: Runner) -> Runner:
        """Return a runner to begin actions after the write of the journal; requests wait for a commit."""
        return GuardedRunner(runner, self.write)

    # Beginning.

    def start(self, exchange: Exchange, link: Link, held: bool | None = None) -> bool:
        """Restore the state of the journal, or begin a journal.

        Args:
            exchange: With its nets, whose executors have their recorders; nothing has happened yet.
            link: To other processes.
            held: Whether all work that comes back is paused, or released; None: it is as it was.

        Returns:
            Whether there was a journal.

        Raises:
            JournalError: It belongs to other nets, or does not fit them; nothing was started.
        """
        self._exchange, self._link = exchange, link
        recovered, self._recovered = self._recovered, None
        if recovered is not None:
            self._compare(recovered)
            _bring_back(recovered, exchange, link, self._store)
            self.epoch = link.epoch
        exchange.inboxes.record = self._record_exchange
        link.record = self._record_link
        link.held = lambda: self.unwritten
        link.fell_back = exchange.begin_incarnation
        if recovered is not None:
            link.come_back()
            if held is not None:
                exchange.hold_all(held)
                link.hold_all(held)
            for executor in exchange.nets.values():
                executor.resume()
        self.compact()
        return recovered is not None

    def _recover(self) -> Recovered | None:
        """Return the content of the folder; set a damaged journal aside and begin without one.

        The others learn from the new incarnation of this process that it has forgotten what they asked each other.
        """
        try:
            return self._log.recover()
        except DamagedJournalError as error:
            aside = set_aside(self._files, "damaged")
            self.lost = f"the journal of {self._node} was damaged, and what it told is forgotten"
            self._observer.forgot(
                f"{error.message}; it is kept in {self._files.name}/{aside}, and {self._node} begins anew: "
                "its commands are forgotten"
            )
            return None

    def _look_at(self, recovered: Recovered) -> None:
        """Read the header, and report an incomplete end."""
        header = recovered.header
        match header:
            case {"node": str(node), "nets": dict(nets)}:
                if node != self._node:
                    text = f"{recovered.file}: this is the journal of {node}, not of {self._node}"
                    raise JournalError(text, file=recovered.file, node=node)
                self.found = {
                    str(net): (str(known.get("source", "")), str(known.get("fingerprint", "")))
                    for net, known in nets.items()
                }
                self.of_this_run = header.get("run", "") == self._run
            case _:
                raise JournalError(f"{recovered.file}: its header names no node and nets", file=recovered.file)
        if recovered.torn:
            power = "if the computer lost its power, more may be missing, and an action that began may begin again"
            self._observer.forgot(
                f"{recovered.file}: what was written last, from byte {recovered.size} on, is not whole "
                f"({recovered.torn} bytes) and is dropped{'' if self._sync is Sync.DISK else f'; {power}'}",
            )

    def _compare(self, recovered: Recovered) -> None:
        """Check whether the nets are the nets of the journal."""
        assert self._exchange is not None
        known = self._header()["nets"]
        there = recovered.header["nets"]
        assert isinstance(known, dict)
        assert isinstance(there, dict)
        wrong = [
            f"net {net} {'is not in it' if net not in there else 'is missing' if net not in known else 'was changed'}"
            for net in sorted(known.keys() | there.keys())
            if net not in known or net not in there or known[net]["fingerprint"] != there[net].get("fingerprint")
        ]
        if wrong:
            raise JournalError(
                f"{recovered.file}: the journal belongs to other nets: {', '.join(wrong)}. Start with the nets of the "
                f"journal, or {DISCARD}",
                file=recovered.file,
                nets=sorted(there),
            )

    # Writing.

    def write(self) -> None:
        """Write all events so far; return once the events are safe.

        Raises:
            JournalError: It cannot be written; nothing may leave now, and it may be tried again.
        """
        entries, mark = self._entries, self._store.mark
        if entries and mark != self._mark:
            entries.append(encode_json(["store", str(mark)]))
            self._mark = mark
        batch = f"[{','.join(entries)}]" if entries else ""
        if self._outdated or len(batch) > MOST_BYTES:  # what could not be written for long is too long for a record
            self.compact()
        elif entries:
            self._log.append(batch)
            entries.clear()

    @property
    def unwritten(self) -> bool:
        """Whether an event is not on file."""
        return bool(self._entries) or self._outdated

    def require_writable(self) -> None:
        """Write all events so far, or an empty batch: the sender of a new request hears of a full disk now.

        Raises:
            JournalError: As :meth:`write`.
        """
        if self.unwritten:
            self.write()
        else:
            self._log.append("[]")

    def commit(self) -> None:
        """Write all events so far, and release the messages dependent on the events; call after pumping the nets.

        Raises:
            JournalError: As :meth:`write`.
        """
        self.write()
        assert self._link is not None
        self._link.flush()
        size = self._log.size
        old = size > self._compact_soon and clock.monotonic() - self._compacted_at > COMPACT_PERIOD_S
        if old or size > self._compact_at:
            try:
                self.compact()
            except (NetError, JournalError) as error:
                # an action that runs holds what JSON cannot carry, or the disk is full; both may be over later
                self._compact_at = self._compact_soon = 2 * size
                self._observer.troubled("", f"the journal is not compacted now: {error}")

    def renew(self) -> None:
        """Begin a new file for a net in the place of the predecessor; nothing more is written to the old one.

        Raises:
            JournalError: As :meth:`compact`; it is tried again with the next write.
            NetError: Likewise.
        """
        self._outdated = True
        self.compact()

    def compact(self) -> None:
        """Begin a new file with a snapshot; call also after a net was added or removed.

        Raises:
            JournalError: It cannot be written; the old file is still in use.
            NetError: JSON cannot carry what a net holds; likewise.
        """
        assert self._exchange is not None
        assert self._link is not None
        nets = {name: net_state(executor) for name, executor in self._exchange.nets.items()}
        mark = self._store.mark
        state = {
            "nets": nets,
            "exchange": exchange_state(self._exchange),
            "link": link_state(self._link),
            **({} if mark is None else {"store": str(mark)}),
        }
        self._log.replace(self._header(), state)
        self._mark = mark
        self._entries.clear()  # the snapshot has all that has happened
        self._outdated = False
        self._compact_at = max(self._compact_bytes, 4 * self._log.size)
        self._compact_soon = max(min(COMPACT_SOON_BYTES, self._compact_bytes), 4 * self._log.size)
        self._compacted_at = clock.monotonic()

    def close(self) -> None:
        """Write all events so far, and give the folder back."""
        try:
            self.write()
        finally:
            self._log.close()
            self._files.unlock()

    @staticmethod
    def discard(folder: Path) -> str | None:
        """Move a journal aside, so the next start begins anew; nothing is deleted.

        Returns:
            Where it is now; None if there was none.

        Raises:
            JournalError: A process is using it, or it cannot be moved.
        """
        aside = discard(Folder(folder))
        return None if aside is None else str(folder / aside)

    def _header(self) -> dict[str, object]:
        assert self._exchange is not None
        for name, executor in self._exchange.nets.items():
            net = executor.written
            if name not in self._described or self._described[name][0] is not net:
                self._described[name] = net, {"fingerprint": fingerprint(net), "source": net.source}
        nets = {name: self._described[name][1] for name in self._exchange.nets}
        return {"node": self._node, "nets": nets, **({"run": self._run} if self._run else {})}

    def _record_exchange(self, entry: ExchangeEntry) -> None:
        self._entries.append(f'["exchange",{EXCHANGE_ENTRY.encode(entry)}]')

    def _record_link(self, entry: LinkEntry) -> None:
        self._entries.append(f'["link",{LINK_ENTRY.encode(entry)}]')


class GuardedRunner:
    """Has the journal written, then the action begun.

    A request leaves with the next commit anyway; not to write it apart keeps it in one batch with its firing.

    Args:
        runner: Does the rest.
        write: Writes the journal; raises where it cannot.
    """

    def __init__(self, runner: Runner, write: Callable[[], None]) -> None:
        self._runner, self._write = runner, write
        self.watch, self.waits, self.ask = runner.watch, runner.waits, runner.ask

    def start(self, owner: ActionOwner, activity: Activity, context: ActionContext) -> None:
        """Start an action; an action unfit for the journal fails."""
        if not isinstance(activity.action, RequestAction):
            try:
                self._write()
            except JournalError as error:
                owner.ended(activity, error)
                return
        self._runner.start(owner, activity, context)

    def direct(self, action: Action) -> ActionFunction | None:
        """Return the function of an action for a direct call."""
        function = self._runner.direct(action)
        if function is None:
            return None

        def guarded(context: ActionContext) -> object | Awaitable[object]:
            self._write()
            return function(context)

        return guarded


# Coming back: the snapshot, then batch after batch what has happened since.


def _bring_back(recovered: Recovered, exchange: Exchange, link: Link, store: SeenStore) -> None:
    """Restore the state after the last written batch.

    Raises:
        JournalError: A record does not fit; names file, offset and number.
    """
    number, offset = 2, 0
    try:
        _restore(recovered.state, exchange, link, store)
        for record, batch in recovered.batches:
            number, offset = record.number, record.offset
            for entry in batch:
                _replay(entry, exchange, link, store)
        exchange.inboxes.deliver_again()
    except (ImError, ValueError, LookupError, TypeError, AttributeError, AssertionError) as error:
        raise JournalError(
            f"{recovered.file}: record {number} at byte {offset} does not fit what was before it "
            f"({type(error).__name__}: {error}); nothing was started. To go on without it, {DISCARD}",
            file=recovered.file,
            record=number,
            offset=offset,
        ) from error


def _restore(state: Mapping[str, object], exchange: Exchange, link: Link, store: SeenStore) -> None:
    match state:
        case {"nets": dict(nets), "exchange": dict(exchanged), "link": dict(linked)}:
            for name, content in nets.items():
                restore_net(exchange.nets[name], content)
            restore_exchange(exchange, exchanged)
            restore_link(link, linked)
            if "store" in state:
                store.mark = StoreMark.of(str(state["store"]))
        case _:
            raise ValueError("the snapshot has no nets, exchange and link")


def _replay(entry: object, exchange: Exchange, link: Link, store: SeenStore) -> None:
    match entry:
        case ["net", str(net), content]:
            happened = NET_ENTRY.decode(content)
            exchange.nets[net].replay(happened)
            exchange.inboxes.deliveries.taken(net, happened)
        case ["exchange", content]:
            exchange.replay(EXCHANGE_ENTRY.decode(content))
        case ["link", content]:
            link.replay(LINK_ENTRY.decode(content))
        case ["store", str(mark)]:
            store.mark = StoreMark.of(mark)
        case _:
            raise ValueError(f"{str(entry)[:200]} is no entry")


# Whether a journal belongs to a net.

_UNIMPORTANT = ("line", "file", "source", "description", "marks", "title", "says")
_ADDED: Mapping[str, object] = {
    "resource": None,
    "symbol_of": None,
    "symbol_expires": None,
    "retry_of": None,
    "until": None,
    "object_type": None,
    "object_scope": ObjectScope.COMMAND,
    "arguments": None,
    "commands": {},
    "assume": {},
    "at_once": 1,
    "result": {},
    "store": {},
    "acts_on": None,
    "resets": (),
    "unless": (),
    "servers": None,
    "cancels": None,
    "keeps_failure": False,
    "silent": None,
    "former": "",
}
"""Fields that nets have not always had, with what says nothing: then a net is what it was without them."""


def fingerprint(net: Net) -> str:
    """Return 16 hexadecimal digits, different for nets of different behaviour.

    Args:
        net: The net, as written; where it was written, and its description, do not count.
    """
    text = encode_json(_plain(net))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: object) -> object:
    if isinstance(value, (str, int, float, type(None))):
        return value.name if isinstance(value, enum.Enum) else value
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return [[_plain(key), _plain(entry)] for key, entry in value.items()]
    kind: type = type(value)
    names = _fields(kind)
    if names:
        fields = {name: getattr(value, name) for name in names}
        added = dict(_ADDED)
        if fields.get("data_object") is not None:
            del added["object_scope"]  # every data object was one of the machine
        said = {name: _plain(each) for name, each in fields.items() if name not in added or each != added[name]}
        return [kind.__name__, said]
    return repr(value)


@functools.cache
def _fields(kind: type) -> tuple[str, ...]:
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple(field.name for field in dataclasses.fields(kind) if field.name not in _UNIMPORTANT)
