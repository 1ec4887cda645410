"""Proofs of nets in files of the user's cache: unchanged nets need no second proof.

A proof is known by its fingerprint: what the nets are, but for their descriptions, and what has proved it. A file that
is damaged, or a cache that cannot be read or written, is no proof, and nets are then verified as if there were none.
"""

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import pydantic

from im_core import files
from im_core.errors import DataError, StoreError
from im_core.files import make_folder, read_bytes, write_whole
from im_core.names import cache_dir
from im_core.text.jsontext import load_json
from im_pnt.model.net import Net
from im_pnt.netfile import yaml_text
from im_pnt_analysis.guards.coverage import GuardDecisions, decide_guards, recall_decisions, types_read
from im_pnt_analysis.verify.report import Report

MOST = 1000
"""Proofs that are kept, the newest ones."""

_PROVERS = ("im_pnt", "im_pnt_analysis")
"""Packages that a verdict comes from."""


class Proof(pydantic.BaseModel):
    """Content of a proof file.

    Attributes:
        fingerprint: Of what was proved; the name of the file.
        states: Number of reachable markings; None where they were not counted.
        assumptions: What the verdict takes for granted.
        comes_to_rest: As of :class:`~im_pnt_analysis.verify.report.Report`.
        guards: Decisions about the guards of each net.
    """

    fingerprint: str
    states: int | None
    assumptions: list[str]
    comes_to_rest: bool | None
    guards: dict[str, GuardDecisions]


def find_proof(nets: Sequence[Net], key: str) -> Report | None:
    """Return the verdict on nets verified before, and recall the decisions about their guards; None without one.

    Args:
        nets: Nets as written, in any order.
        key: Their fingerprint.
    """
    try:
        proof = Proof.model_validate(load_json(_folder() / f"{key}.json", files.MEBIBYTE))
    except (DataError, StoreError, pydantic.ValidationError):
        return None
    if proof.fingerprint != key or proof.guards.keys() != {net.name for net in nets}:
        return None
    for net in nets:
        recall_decisions(net, proof.guards[net.name])
    report = Report([net.name for net in nets], proved_before=True, assumptions=proof.assumptions)
    answers = {"bounded": True, "has_deadlock": False, "resources_return": True, "resources_held": True}
    report.answer("proved before", states=proof.states, comes_to_rest=proof.comes_to_rest, **answers)
    report.leave("not asked")
    report.decide()
    return report


def keep_proof(nets: Sequence[Net], key: str, report: Report) -> None:
    """Keep the proof of nets; without room for the proof, the nets will be verified again."""
    proof = Proof(
        fingerprint=key,
        states=report.states,
        assumptions=report.assumptions,
        comes_to_rest=report.comes_to_rest,
        guards={net.name: decide_guards(net) for net in nets},
    )
    with contextlib.suppress(StoreError, DataError, OSError):
        folder = _folder()
        write_whole(folder / f"{key}.json", proof.model_dump_json())
        kept = sorted(folder.glob("*.json"), key=lambda path: path.stat().st_mtime)
        for path in kept[:-MOST]:
            path.unlink(missing_ok=True)


def _folder() -> Path:
    return make_folder(cache_dir() / "proofs")


def kept(nets: Sequence[Net], prove: Callable[[], Report]) -> Report:
    """Return the kept proof of nets, or a new one."""
    key = fingerprint(nets)
    report = find_proof(nets, key)
    if report is None:
        report = prove()
        report.composed = report.composed or list(nets)
        if report.ok:
            keep_proof(nets, key, report)
    return report


def fingerprint(nets: Sequence[Net]) -> str:
    """Return 64 hexadecimal digits, different for nets, or provers, with different proofs.

    Args:
        nets: Nets as written, in any order.
    """
    texts = sorted("\n".join((yaml_text(replace(net, description="")), *types_read(net))) for net in nets)
    return hashlib.sha256("\0".join((_prover(), *texts)).encode()).hexdigest()


@cache
def _prover() -> str:
    """Return a fingerprint of the prover: another version of the prover proves anew."""
    whole = hashlib.sha256()
    for name in _PROVERS:
        folder = Path(import_module(name).__path__[0])
        for path in sorted(folder.rglob("*.py")):
            whole.update(f"{path.relative_to(folder)}\0".encode() + read_bytes(path) + b"\0")
    return whole.hexdigest()
