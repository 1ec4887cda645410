"""Check whether the nets of a machine may run together: in a separate process, before START is given.

Each node has verified its nets alone when it is configured, and describes them on ``/pnt/nets``. After that
``scripts/im pnt verify`` verifies those that talk to each other together. What was proved before, and is unchanged, it
finds in its cache.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import pydantic

from im_bringup.tasks.registry import TaskRecord
from im_core.errors import ImError
from im_core.files import make_folder, read_text, write_whole
from im_core.processes.process import ChildProcess
from im_core.processes.startup import net_digest, nets_told
from im_core.text.bounded_json import read_json

#: What is ``pnt`` on the command line.
PROVER = "im_pnt_analysis.cli"
#: Exit codes of ``scripts/im pnt verify``.
VERIFIED, UNPROVED = 0, 3

Prove = Callable[[Sequence[Path], Path], ChildProcess]


class _Description(pydantic.BaseModel):
    yaml: str


def prove(files: Sequence[Path], log: Path) -> ChildProcess:
    """Begin to verify net files; the findings are written into a log, the verdict last."""
    return ChildProcess.of_module(PROVER, ["verify", "--loaded", *map(str, files)], log=log)


class MachineNets:
    """Nets of a starting machine.

    Args:
        run_dir: Folder of the machine; gets a folder ``nets`` with the files that are verified, and the log.
        unproved: Whether the machine may start where it cannot be decided in time whether its nets may run.
        prove: Begins to verify them.

    Attributes:
        verdict: What was found in one sentence; empty before, and where there are no nets.
        failure: Why START must not be given; empty if it may, or nothing is decided.
        proved: False where the nets run without proof.
    """

    def __init__(self, run_dir: Path, *, unproved: bool, prove: Prove = prove) -> None:
        self._folder, self._log = run_dir / "nets", run_dir / "log" / "verification.log"
        self._unproved, self._prove = unproved, prove
        self._told: dict[tuple[str, str], str] = {}
        self._digests: dict[tuple[str, str], str] = {}
        self._child: ChildProcess | None = None
        self._nets: list[str] = []
        self.verdict = self.failure = ""
        self.proved = True

    def reported(self, node: str, digests: Mapping[str, str]) -> None:
        """Take the net digests of a node: a net description counts only if the digest equals the reported one."""
        self._digests.update({(node, net): digest for net, digest in digests.items()})

    def described(self, node: str, net: str, description: str) -> None:
        """Take the description of a net; used as long as the nets are not verified.

        Args:
            node: Fully qualified name of the node that runs it.
            net: Its name.
            description: JSON as on ``/pnt/nets``.

        Raises:
            DataError: It is no description.
        """
        if (node, net) not in self._digests or self._child is not None:
            return
        text = read_json(_Description, description, f"the description of net {net}").yaml
        if net_digest(text) == self._digests[node, net]:
            self._told[node, net] = text

    def settled(self, records: Iterable[TaskRecord]) -> bool:
        """Go on with the verification; return whether the verification is over.

        Args:
            records: Those of all tasks, which are configured and have told which nets they run.
        """
        if self._child is not None:
            return bool(self.verdict or self.failure) or self._ended(self._child)
        runs = _runs(records)
        self.failure = _twice(runs)
        if self.failure or not runs:
            return True
        if self._missing(runs):
            return False
        try:
            self._begin(runs)
        except ImError as error:
            self.failure = error.message
        return bool(self.failure)

    def _begin(self, runs: list[tuple[str, str, str]]) -> None:
        self._nets = sorted(net for _, _, net in runs)
        self._log.unlink(missing_ok=True)
        for former in self._folder.glob("*.yaml"):
            former.unlink(missing_ok=True)
        self._child = self._prove([self._written(node, net) for _, node, net in runs], self._log)

    def waits(self, records: Iterable[TaskRecord]) -> list[str]:
        """Return one sentence for each awaited thing."""
        if self._child is not None:
            return [f"nets {', '.join(self._nets)} are still being verified together"] if not self.verdict else []
        return [f"task {task} has not described its net {net}" for task, _, net in self._missing(_runs(records))]

    def stop(self) -> None:
        """Stop a running verification."""
        if self._child is not None:
            self._child.stop()

    def _missing(self, runs: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
        return [run for run in runs if run[1:] not in self._told]

    def _written(self, node: str, net: str) -> Path:
        return write_whole(make_folder(self._folder) / f"{net}.yaml", self._told[node, net])

    def _ended(self, child: ChildProcess) -> bool:
        code = child.poll()
        if code is None:
            return False
        if code == VERIFIED:
            self.verdict = child.last_words()
        elif code == UNPROVED and self._unproved:
            self.proved, self.verdict = False, f"started all the same: {child.last_words()}"
        elif code == UNPROVED:
            self.failure = child.last_words()
        else:
            self.failure = _whole(self._log) or child.obituary()
        return True


def _runs(records: Iterable[TaskRecord]) -> list[tuple[str, str, str]]:
    """Return task, node and net of all nets run by tasks."""
    return [(record.name, record.placed.task.node, net) for record in records for net in nets_told(record.detail)]


def _twice(runs: Iterable[tuple[str, str, str]]) -> str:
    tasks: dict[str, str] = {}
    for task, _, net in runs:
        if tasks.setdefault(net, task) != task:
            return f"net {net} is run by task {tasks[net]} and by task {task}; a machine runs a net once"
    return ""


def _whole(log: Path) -> str:
    """Return the output of ``scripts/im pnt verify``, without the verified nets."""
    lines = read_text(log).strip().splitlines()
    begin = next((rank for rank, line in enumerate(lines) if " refused:" in line), len(lines) - 1)
    return "\n".join(lines[max(0, begin) :])
