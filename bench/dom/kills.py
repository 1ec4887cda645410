"""A store that is killed again and again: what it has acknowledged is there, as it was, when it is opened anew.

``python -m bench.dom.kills FOLDER SEED`` is the one that is killed: it changes objects at random in groups, and writes
a line for each change that the store has acknowledged.
"""

import json
import os
import random
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path

from bench.power.disk import Disk
from im_dom.object_record import ObjectRecord
from im_dom.store import ObjectStore

NAMES = [f"object/{number}" for number in range(6)]
KIND = "std_msgs/msg/String"
#: Arguments of the interpreter that begin the process which is killed; folder and seed follow.
COMMAND = ("-m", "bench.dom.kills")

#: Of an object: its version, whether that is valid, and the hash of its data.
Facts = tuple[int, bool, str]


def facts(store: ObjectStore) -> dict[str, Facts]:
    """What a store says of its objects, each version's data having been read."""
    return {
        record.name: (
            record.version,
            record.valid,
            sha256(store.get(record.name, version=record.version)[1]).hexdigest(),
        )
        for record in store.records()
    }


def kill_once(folder: Path, seed: int, *, power: bool = False) -> int:
    """Kill a process that changes the store of a folder, and compare.

    Args:
        folder: Holds the store, with what former incarnations have left.
        seed: Of what it does, and of when it is killed.
        power: Whether the power goes with it: what was not synchronised is there by chance only.

    Returns:
        How many acknowledged changes were looked at.

    Raises:
        AssertionError: Something that was acknowledged is not there, or is there as it never was.
    """
    draw = random.Random(seed)
    before = ObjectStore(folder / "dom.sqlite")
    started = facts(before)
    before.close()
    most = draw.randrange(200)
    command = [sys.executable, *COMMAND, str(folder), str(seed)]
    disk = Disk(folder) if power else None
    environment = {**os.environ, **(disk.environment if disk else {})}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline() for _ in range(most + 1)]
        child.kill()
        lines += child.stdout.readlines()
    if disk is not None:
        disk.lose_power(draw)
    told = [json.loads(line) for line in lines if line.endswith(b"\n")]
    assert told, "it has said nothing"
    store = ObjectStore(folder / "dom.sqlite")
    assert store.aside == "", store.aside
    there = facts(store)
    store.close()
    acknowledged: dict[str, list[Facts]] = {name: [fact] for name, fact in started.items()}
    for name, *fact in told:
        acknowledged.setdefault(name, []).append((fact[0], fact[1], fact[2]))
    for name, known in acknowledged.items():
        version, valid, content = known[-1]
        assert name in there, f"{name} is gone, of which version {version} was acknowledged"
        found = there[name]
        assert found[0] >= version, f"{name} is at version {found[0]}, of which {version} was acknowledged"
        if found[0] == version:  # only an invalidation may have been made that was not acknowledged any more
            assert found[2] == content, f"{name}: version {version} has other data than were acknowledged"
            assert valid or not found[1], f"{name}: version {version} is valid again"
    return len(told)


def _change(store: ObjectStore, draw: random.Random) -> Callable[[], tuple[ObjectRecord, bytes]]:
    name, length, kind = draw.choice(NAMES), draw.choice((5, 300, 20_000)), draw.random()
    data, known = draw.randbytes(length), {record.name for record in store.records()}
    asked = str(draw.random())

    def put() -> tuple[ObjectRecord, bytes]:
        return store.put(name, KIND, data, "", "killed", 0), data

    def invalidate() -> tuple[ObjectRecord, bytes]:
        record = store.invalidate(name, "killed", 0)
        return record, store.get(name, version=record.version)[1]

    def append() -> tuple[ObjectRecord, bytes]:
        if not store.record(name).valid:  # by what is done together with this
            return put()
        grown = store.get(name)[1] + data[:5]
        return store.append(name, KIND, lambda present: present + data[:5], "killed", 0, request=asked), grown

    if name not in known or kind < 0.6:
        return put
    return invalidate if kind < 0.8 else append


def work(folder: Path, seed: int, say: Callable[[str], object]) -> None:
    """Change objects until killed."""
    draw = random.Random(seed)
    store = ObjectStore(folder / "dom.sqlite")
    while True:
        works = [_change(store, draw) for _ in range(draw.choice((1, 1, 3, 8)))]
        for found in store.together(works):
            if isinstance(found, Exception):
                raise found
            assert isinstance(found, tuple)
            record, data = found
            say(json.dumps([record.name, record.version, record.valid, sha256(data).hexdigest()]))


if __name__ == "__main__":
    work(Path(sys.argv[1]), int(sys.argv[2]), partial(print, flush=True))
