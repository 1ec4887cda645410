"""Files of a bag, listed in ``metadata.yaml``; completion of an interrupted recording."""

import fcntl
import os
import struct
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from mcap.reader import make_reader
from mcap.records import Statistics
from mcap.summary import Summary

from im_bag.contents import MAGIC, Contents, end_of, last_index, scan
from im_core import clock
from im_core.errors import StoreError
from im_core.files import MEBIBYTE, FileError, check_regular, read_text, write_whole
from im_core.text.yamltext import YamlError, as_data, read_yaml, write_yaml

METADATA = "metadata.yaml"
LARGEST_METADATA = 16 * MEBIBYTE

#: What the header of a file names whose recorder locks it (im_bag/writer.py).
LIBRARY = "im"
#: A file of another recorder, which takes no lock, may still be written while its last bytes are no older [s].
_SETTLED_S = 5.0
#: By how much parts of one bag may overlap: a recorder takes what waits in its queues, one after the other [ns].
_OVERLAP_NS = 2 * 10**9
_RECORDED = "is being recorded; end the recording first"
_NOTHING = "has no message: the recording ended before the first was written"
#: How a file begins: what marks it, and opcode and length of its header.
_BEGIN = struct.Struct(f"<{len(MAGIC)}sBQ")


def complete_bag(bag: Path) -> None:
    """Complete the bag of a killed recorder: files without an end, and a folder without metadata.

    A file that a recorder is writing is left alone; the bag is then what was complete before it.

    Args:
        bag: Folder of a bag, or a file of it; one whose metadata name all its MCAP files is not looked at further.

    Raises:
        DataError: It cannot be completed: it is being recorded, has no message, is no MCAP file, was complete once
            and is cut now, lacks a file that its metadata list, or has one that does not belong to it.
    """
    if not bag.is_dir():
        if bag.suffix == ".mcap" and not _has_end(bag):
            complete_file(bag)
        return
    described = (bag / METADATA).exists()
    listed = _listed_files(bag / METADATA) if described else []
    files = sorted(bag.glob("*.mcap"))
    for path in files:
        if path.name in listed and _is_cut(path):
            text = "lacks its end, as a copy that was broken off; copy it again, or remove"
            raise FileError(path, f"{text} {METADATA}: the complete part of the file is then read")
    if not (new := [path for path in files if path.name not in listed]):
        return
    busy = [path for path in new if is_recorded(path)]
    if described and busy:
        return
    if busy:
        raise FileError(bag, _RECORDED)
    contents = _contents(files)
    _check_belonging(bag, listed, contents)
    for path in new:
        if path in contents and not _has_end(path):
            complete_file(path)
    _describe(bag, contents)


def parts(bag: Path) -> list[Path]:
    """Return the MCAP files in the folder of a bag, ordered by first message; empty files are left out."""
    return list(_contents(bag.glob("*.mcap")))


def _contents(files: Iterable[Path]) -> dict[Path, Contents]:
    """Return the contents of files, ordered by first message and not by file name; empty ones are left out."""
    found = {}
    for path in files:
        if not _is_empty(path):
            with path.open("rb") as file:
                found[path] = _summary(path) if _has_end(path) else scan(path, file)
    return dict(sorted(found.items(), key=lambda item: (not item[1].counts, item[1].begin_ns, item[0].name)))


def _is_empty(path: Path) -> bool:
    """Check whether a file has no header on the disk, or zeros in place of the header: the recorder had only begun."""
    with path.open("rb") as file:
        begin = file.read(_BEGIN.size)
        if begin.startswith(MAGIC):
            return len(begin) < _BEGIN.size or _BEGIN.size + _BEGIN.unpack(begin)[-1] > path.stat().st_size
        rest = iter(lambda: file.read(MEBIBYTE), b"")
        return MAGIC.startswith(begin) or (not any(begin) and all(piece.count(0) == len(piece) for piece in rest))


def _check_belonging(bag: Path, listed: Sequence[str], contents: Mapping[Path, Contents]) -> None:
    """Refuse files not left by a killed recorder: a copy of a part, a file of another bag, a gap.

    Raises:
        FileError: A listed file is missing, or one that is not listed does not belong to the bag.
    """
    if missing := [name for name in listed if not (bag / name).exists()]:
        text = f"lacks {', '.join(missing)}, which {METADATA} lists; put it back, or remove {METADATA}"
        raise FileError(bag, f"{text}: the files in the folder are then read")
    new = sorted(
        (path for path, held in contents.items() if path.name not in listed and held.counts),
        key=lambda path: (contents[path].begin_ns, len(path.name), path.name),
    )
    if new and any(not name.endswith(".mcap") for name in listed):
        raise FileError(new[0], f"does not belong to this bag, which is in other files by its {METADATA}; move it away")
    taken = [path for path in contents if path.name in listed]
    for path in new:
        for other in taken:
            if _is_of_the_same_time(contents[path], contents[other]):
                text = f"its time overlaps that of {other.name}, as in a copy or another bag: move it away"
                raise FileError(path, f"does not belong to this bag; {text}")
        taken.append(path)


def _is_of_the_same_time(one: Contents, other: Contents) -> bool:
    overlap_ns = min(one.end_ns, other.end_ns) - max(one.begin_ns, other.begin_ns)
    return bool(other.counts) and (one.begin_ns == other.begin_ns or overlap_ns > _OVERLAP_NS)


def is_recorded(path: Path) -> bool:
    """Check whether a recorder has the file open."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False


def complete_file(path: Path) -> None:
    """Cut a file after the last whole record, and append the missing summary and end.

    Raises:
        DataError: It is no MCAP file, or it is being recorded, as far as can be told.
        StoreError: It cannot be written.
    """
    try:
        with path.open("r+b") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise FileError(path, _RECORDED) from None
            size = os.fstat(file.fileno()).st_size
            if _is_empty(path):
                raise FileError(path, _NOTHING)
            contents = scan(path, file)
            if contents.library != LIBRARY:
                _check_settled(path, os.fstat(file.fileno()), size)
            file.truncate(contents.end)
            file.seek(contents.end)
            index = last_index(contents)
            file.write(index + end_of(contents, contents.end + len(index)))
    except OSError as error:
        raise StoreError.of("completed", path, error) from error


def _check_settled(path: Path, status: os.stat_result, size: int) -> None:
    """Refuse a growing file, or a file with bytes added just now: the recorder may still be running."""
    if status.st_size != size:
        raise FileError(path, _RECORDED)
    if abs(clock.wall() - status.st_mtime) < _SETTLED_S:
        text = f"lacks its end and was written less than {_SETTLED_S:g} s ago, perhaps by a recorder that still runs"
        raise FileError(path, f"{text}; end the recording, or try again in {_SETTLED_S:g} s")


def write_metadata(bag: Path, files: Sequence[Path]) -> None:
    """Write ``metadata.yaml`` of a bag from the summaries of the files.

    Args:
        bag: Folder of the bag.
        files: Complete MCAP files in it, in their order.

    Raises:
        DataError: There is none, or one is no MCAP file.
        StoreError: It cannot be written.
    """
    _describe(bag, {path: _summary(path) for path in files})


def _describe(bag: Path, contents: Mapping[Path, Contents]) -> None:
    """Write ``metadata.yaml``; exceptions as of :func:`write_metadata`."""
    if not contents:
        raise FileError(bag, _NOTHING)
    content = {"rosbag2_bagfile_information": _described(list(contents.items()))}
    write_whole(bag / METADATA, write_yaml(content))


def _has_end(path: Path) -> bool:
    check_regular(path, path.stat())
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) < 2 * len(MAGIC):
            return False
        file.seek(-len(MAGIC), os.SEEK_END)
        return file.read() == MAGIC


def _is_cut(path: Path) -> bool:
    """Check whether the existing part of a file is an MCAP file."""
    if _has_end(path):
        return False
    with path.open("rb") as file:
        return MAGIC.startswith(file.read(len(MAGIC)))


def _summary(path: Path) -> Contents:
    """Return the contents by the summary of a complete file, or by the file if the summary lacks channels or types."""
    with path.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
        except Exception as error:  # of any name, as above
            raise FileError(path, f"cannot be read: {error or type(error).__name__}") from error
        if summary is None or (told := summary.statistics) is None or not _is_told(summary, told):
            file.seek(0)
            return scan(path, file)
        return Contents(
            schemas=summary.schemas,
            channels=summary.channels,
            counts=Counter(told.channel_message_counts),
            begin_ns=told.message_start_time,
            end_ns=told.message_end_time,
        )


def _is_told(summary: Summary, told: Statistics) -> bool:
    defined = {number for number, channel in summary.channels.items() if channel.schema_id in summary.schemas}
    counts = told.channel_message_counts
    return sum(counts.values()) == told.message_count and counts.keys() <= defined


def _listed_files(metadata: Path) -> list[str]:
    try:
        content: Any = as_data(read_yaml(read_text(metadata, LARGEST_METADATA), str(metadata)))
        return [Path(name).name for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except YamlError as error:
        raise FileError(metadata, error.sentence, error.place.line) from error
    except (LookupError, TypeError) as error:
        raise FileError(metadata, "cannot be read: it says nothing of the files of a bag") from error


def _described(files: Sequence[tuple[Path, Contents]]) -> dict[str, Any]:
    filled = [contents for _, contents in files if contents.counts]
    begin = min((contents.begin_ns for contents in filled), default=0)
    end = max((contents.end_ns for contents in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": [path.name for path, _ in files],
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": sum(contents.counts.total() for _, contents in files),
        "topics_with_message_count": _topics([contents for _, contents in files]),
        "compression_format": "",
        "compression_mode": "",
        "files": [
            {
                "path": path.name,
                "starting_time": {"nanoseconds_since_epoch": contents.begin_ns},
                "duration": {"nanoseconds": contents.end_ns - contents.begin_ns},
                "message_count": contents.counts.total(),
            }
            for path, contents in files
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _topics(files: Sequence[Contents]) -> list[dict[str, Any]]:
    """Return each topic, once for each type and type hash."""
    counts: Counter[tuple[str, str, str]] = Counter()
    told: dict[tuple[str, str, str], dict[str, Any]] = {}
    for contents in files:
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema_id)
            type_name = schema.name if schema else ""
            key = channel.topic, type_name, channel.metadata.get("topic_type_hash", "")
            counts[key] += contents.counts[channel.id]
            told[key] = {
                "name": channel.topic,
                "type": type_name,
                "serialization_format": channel.message_encoding,
                "offered_qos_profiles": yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or [],
                "type_description_hash": key[2],
            }
    return [{"topic_metadata": told[key], "message_count": counts[key]} for key in told]
