"""The journal of a process: its nets, its exchange and its link, in one log, written before anything leaves.

What happens is collected, and written as one batch before the next effect: before an action begins (:meth:`guard`) and
before messages, acknowledgements and answers leave (:meth:`commit`). A batch is written whole or not at all, so what a
message caused is never parted from its having been taken, nor a firing from the messages that it sends.
"""

from pathlib import Path

from im_core.clock import wall
from im_pnt.errors import NetError
from im_pnt.events import Observer
from im_pnt.exchange import Exchange
from im_pnt.executive import Runner
from im_pnt.journal.errors import JournalError
from im_pnt.journal.exchange_record import exchange_state
from im_pnt.journal.fingerprint import fingerprint
from im_pnt.journal.folder import Files, Folder
from im_pnt.journal.guarded_runner import GuardedRunner
from im_pnt.journal.link_record import link_state
from im_pnt.journal.log import Log, Recovered, Sync, discard, encode_json
from im_pnt.journal.recovery import bring_back
from im_pnt.link import Link
from im_pnt.net import Net
from im_pnt.record import Entry, Record

COMPACT_BYTES = 8_000_000


class Journal:
    """The journal of one process; holds its folder until :meth:`close`.

    Args:
        files: The folder, by its path, or what stands for one.
        node: Name of the process.
        sync: When a record counts as written.
        compact_bytes: Size of the file above which a new one is begun with a snapshot [bytes].
        observer: Is told of a last record that was not written whole.

    Attributes:
        found: Nets in the journal that was found, with the files they came from; empty if there was none.
        epoch: Incarnation of the process, for its exchange and its link.

    Raises:
        JournalError: Another process uses it, it cannot be read, it is damaged, or it belongs to another node.
    """

    def __init__(
        self,
        files: Files | Path,
        node: str,
        *,
        sync: Sync = Sync.OS,
        compact_bytes: int = COMPACT_BYTES,
        observer: Observer | None = None,
    ) -> None:
        self._files = Folder(files) if isinstance(files, Path) else files
        self._node, self._compact_bytes, self._observer = node, compact_bytes, observer or Observer()
        self._exchange: Exchange | None = None
        self._link: Link | None = None
        self._entries: list[str] = []
        self._tokens: dict[tuple[object, ...], str] = {}
        self._described: dict[str, tuple[Net, dict[str, str]]] = {}
        self._compact_at = compact_bytes
        self.epoch = int(wall() * 1e6)
        self.found: dict[str, str] = {}
        self._files.lock()
        try:
            self._log = Log(self._files, sync)
            self._recovered = self._log.recover()
            if self._recovered is not None:
                self._look_at(self._recovered)
        except JournalError:
            self._files.unlock()
            raise

    # What the nets, the exchange and the link of the process need to be given.

    def recorder(self, net: str) -> Record:
        """Returns what an executive is given to record its events and firings."""
        prefix = f'["net",{encode_json(net)},'
        known: dict[tuple[object, ...], str] = {}

        def record(entry: Entry) -> None:
            if self._exchange is None or self._exchange.muted:
                return
            kind = entry[0]
            if kind == "fire" or (kind == "token" and entry[2] == 1):  # by far the most frequent
                key = tuple(entry)
                text = known.get(key)
                if text is None:
                    text = known[key] = f"{prefix}{encode_json(entry)}]"
                self._entries.append(text)
                if kind == "fire":
                    return
            else:
                try:
                    self._entries.append(f"{prefix}{encode_json(entry)}]")
                except (TypeError, ValueError) as error:
                    text = f"net {net}: what is to be journalled is not JSON data: {error}"
                    raise NetError(text, net=net) from error
            self._exchange.inboxes.deliveries.taken(net, entry)

        return record

    def guard(self, runner: Runner) -> Runner:
        """Returns a runner that begins an action when the journal has been written; requests wait for a commit."""
        return GuardedRunner(runner, self.write)

    # Beginning.

    def start(self, exchange: Exchange, link: Link) -> bool:
        """Brings everything back as it was, or begins a journal.

        Args:
            exchange: With its nets, whose executives have their recorders; nothing has happened yet.
            link: To other processes.

        Returns:
            Whether there was a journal.

        Raises:
            JournalError: It belongs to other nets, or does not fit them; nothing was started.
        """
        self._exchange, self._link = exchange, link
        recovered, self._recovered = self._recovered, None
        if recovered is not None:
            self._compare(recovered)
            exchange.muted = True
            bring_back(recovered, exchange, link)
            exchange.muted = False
            self.epoch = link.epoch
        exchange.inboxes.record = self._record_exchange
        link.record = self._record_link
        link.held = lambda: bool(self._entries)
        if recovered is not None:
            for executive in exchange.nets.values():
                executive.resume()
        self.compact()
        return recovered is not None

    def _look_at(self, recovered: Recovered) -> None:
        """Reads the header, and tells of a last record that was not written whole."""
        header = recovered.header
        match header:
            case {"node": str(node), "nets": dict(nets)}:
                if node != self._node:
                    text = f"{recovered.file}: this is the journal of {node}, not of {self._node}"
                    raise JournalError(text, file=recovered.file, node=node)
                self.found = {str(net): str(known.get("source", "")) for net, known in nets.items()}
            case _:
                raise JournalError(f"{recovered.file}: its header names no node and nets", file=recovered.file)
        if recovered.torn:
            self._observer.troubled(
                "",
                f"{recovered.file}: the last record, at byte {recovered.size}, was not written whole "
                f"({recovered.torn} bytes) and is dropped",
            )

    def _compare(self, recovered: Recovered) -> None:
        """Checks that the nets are those of the journal."""
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
                "journal, or move it aside with Journal.discard and begin anew",
                file=recovered.file,
                nets=sorted(there),
            )

    # Writing.

    def write(self) -> None:
        """Writes what has happened; returns when it is safe.

        Raises:
            JournalError: It cannot be written; nothing may leave now, and it may be tried again.
        """
        if self._entries:
            self._log.append(f"[{','.join(self._entries)}]")
            self._entries.clear()

    def commit(self) -> None:
        """Writes what has happened, and lets the messages go that depend on it; call it when the nets have been pumped.

        Raises:
            JournalError: As :meth:`write`.
        """
        self.write()
        assert self._link is not None
        self._link.flush()
        if self._log.size > self._compact_at:
            try:
                self.compact()
            except NetError as error:  # an action that runs holds what JSON cannot carry; it may have let it go later
                self._compact_at = 2 * self._log.size
                self._observer.troubled("", f"the journal is not compacted now: {error}")

    def compact(self) -> None:
        """Begins a new file with a snapshot; also to be called when a net was added or replaced.

        Raises:
            JournalError: It cannot be written; the old file is still in use.
            NetError: JSON cannot carry what a net holds; likewise.
        """
        assert self._exchange is not None
        assert self._link is not None
        nets = {name: executive.state() for name, executive in self._exchange.nets.items()}
        state = {"nets": nets, "exchange": exchange_state(self._exchange), "link": link_state(self._link)}
        self._log.replace(self._header(), state)
        self._entries.clear()  # the snapshot has all that has happened
        self._compact_at = max(self._compact_bytes, 4 * self._log.size)

    def close(self) -> None:
        """Writes what has happened, and gives the folder back."""
        try:
            self.write()
        finally:
            self._log.close()
            self._files.unlock()

    @staticmethod
    def discard(folder: Path) -> str | None:
        """Moves a journal aside, so that the next start begins anew; nothing is deleted.

        Returns:
            Where it is now; None if there was none.

        Raises:
            JournalError: A process is using it, or it cannot be moved.
        """
        aside = discard(Folder(folder))
        return None if aside is None else str(folder / aside)

    def _header(self) -> dict[str, object]:
        assert self._exchange is not None
        for name, executive in self._exchange.nets.items():
            net = executive.written
            if name not in self._described or self._described[name][0] is not net:
                self._described[name] = net, {"fingerprint": fingerprint(net), "source": net.source}
        return {"node": self._node, "nets": {name: self._described[name][1] for name in self._exchange.nets}}

    def _record_exchange(self, entry: Entry) -> None:
        delivery = entry[2] if entry[0] == "posted" else None
        if not isinstance(delivery, list) or delivery[0] != "token":
            self._entries.append(f'["exchange",{encode_json(entry)}]')
            return
        key = (entry[1], *delivery)
        text = self._tokens.get(key)
        if text is None:
            text = self._tokens[key] = f'["exchange",{encode_json(entry)}]'
        self._entries.append(text)

    def _record_link(self, entry: str) -> None:
        self._entries.append(f'["link",{entry}]')
