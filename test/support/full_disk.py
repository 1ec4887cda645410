"""Stores on a disk that is full; each in a process of its own, for its limits stay with it.

``python -m support.full_disk WAY STORE FOLDER``: the way is ``limit`` (RLIMIT_FSIZE: no file may grow; needs no rights)
or ``tmpfs`` (a file system of 4 MiB, mounted at the folder, in a mount namespace of its own). Prints what the store
said; ends with 1 if something was lost.
"""

import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from im_core.errors import ImError


class Disk:
    """A disk that can be filled and freed."""

    def __init__(self, way: str, folder: Path) -> None:
        self.way, self.folder = way, folder
        if way == "tmpfs":
            subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)], check=True)
        else:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def fill(self) -> None:
        """Nothing more fits."""
        if self.way == "limit":
            resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
            return
        with (self.folder / "filler").open("wb", buffering=0) as file:
            for size in (2**16, 2**12, 1):
                try:
                    while file.write(bytes(size)) == size:
                        pass
                except OSError:
                    continue

    def free(self) -> None:
        """There is room again."""
        if self.way == "limit":
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        else:
            (self.folder / "filler").unlink()


def refused(work: Callable[[], object]) -> None:
    """The store says that it cannot, as an error of ours, however often it is asked."""
    for _ in range(3):
        with pytest.raises(ImError) as caught:
            work()
        print(caught.value.message)
        assert caught.value.code in ("store", "journal")


def dom(disk: Disk) -> None:
    """Data objects."""
    from im_dom.store import ObjectStore

    def put(name: str, data: bytes) -> object:
        return store.put(name, "std_msgs/msg/String", data, "", "test", 0)

    store = ObjectStore(disk.folder / "dom.sqlite")
    put("kept", b"before")
    disk.fill()
    refused(lambda: put("lost", bytes(2**20)))
    refused(lambda: put("kept", bytes(2**20)))
    lost, kept = store.together([lambda: put("lost", bytes(2**20)), lambda: store.get("kept")])
    assert isinstance(lost, ImError)
    assert lost.code == "store"
    assert isinstance(kept, tuple)
    assert kept[1] == b"before"
    assert [record.name for record in store.records()] == ["kept"]
    disk.free()
    put("after", b"after")
    store.close()
    again = ObjectStore(disk.folder / "dom.sqlite")
    assert {record.name: again.get(record.name)[1] for record in again.records()} == {
        "kept": b"before",
        "after": b"after",
    }


def journal(disk: Disk) -> None:
    """The journal of a node."""
    from im_pnt_node.journal.folder import Folder
    from im_pnt_node.journal.log import Log, Sync

    folder = disk.folder / "journal"
    log = Log(Folder(folder), Sync.OS)
    log.recover()
    log.replace({"node": "test"}, {"state": 1})
    log.append('["kept"]')
    disk.fill()
    refused(lambda: log.append('["' + "x" * 20_000 + '"]'))
    refused(lambda: log.replace({"node": "test"}, {"state": "y" * 20_000}))
    disk.free()
    log.append('["after"]')
    assert [batch for _, batch in Log(Folder(folder), Sync.OS).recover().batches] == [["kept"], ["after"]]  # type: ignore[union-attr]


def bag(disk: Disk) -> None:
    """A recording: what was complete before can be read."""
    from im_bag import BagReader, BagWriter, Delivery, PartLimits

    writer = BagWriter(disk.folder / "bag", PartLimits(size_bytes=2000, free_bytes=0))
    writer.add_topic("/a", "std_msgs/msg/String", Delivery(reliable=True, latched=False, depth=1))
    for number in range(30):
        writer.write("/a", number, bytes(100))
    disk.fill()

    refused(lambda: [writer.write("/a", number, bytes(100)) for number in range(30, 60)])
    writer.close()
    with BagReader(disk.folder / "bag") as reader:
        assert reader.counts == {"/a": 20}


def results(disk: Disk) -> None:
    """The report of a command, and what points to the latest."""
    from im_dispatcher.report import make_directory, write_report

    first = make_directory(disk.folder, "20260101-000000")
    write_report(first, {"number": 1})
    second = make_directory(disk.folder, "20260101-000001")
    disk.fill()
    refused(lambda: write_report(second, {"number": "2" * 20_000}))
    assert list(second.iterdir()) == []
    assert (disk.folder / "latest").resolve() == first
    disk.free()
    write_report(second, {"number": 2})
    assert (disk.folder / "latest").resolve() == second


STORES = {store.__name__: store for store in (dom, journal, bag, results)}

if __name__ == "__main__":
    way, name, folder = sys.argv[1:]
    STORES[name](Disk(way, Path(folder)))
