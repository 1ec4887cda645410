"""Control law in a separate process, seen from the servo loop (paper, section 4: multiprocessor algorithms)."""

import itertools
import json
import os
import signal
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_core import clock, names
from im_core.errors import ConfigError, LinkError
from im_core.processes.process import ChildProcess
from im_mcs.control.controller import ControlInput
from im_mcs.control.guard import ControlLawError
from im_mcs.control.link import LawLink
from im_mcs.model import ControlledModel

_POLL_S = 0.05
_END_S = 1.0
_NUMBERS = itertools.count()


class LawProcess:
    """Process of a law: started before the loop, ended with the loop, and by the kernel if the loop dies.

    Args:
        law: ``module:Class``.
        cell: Parameters.
        model_error: Share by which the law's model is wrong.
        groups: Of each group that may use the law, a JSON object of arguments of
            :class:`im_mcs.control.ControllerSetup`: ``joints``, ``period_s``, ``torque_limit``, ``parameters``.
        priority: SCHED_FIFO priority, where permitted.
        paced: Whether the loop sleeps until a deadline in every tick.
    """

    def __init__(
        self, law: str, cell: Cell, model_error: float, groups: Sequence[dict[str, Any]], priority: int, paced: bool
    ) -> None:
        self.law = law
        self._at_work = False
        name = f"{names.instance()}_law_{os.getpid()}_{next(_NUMBERS)}"
        model = ControlledModel(cell)
        self._link = LawLink.create(name, LawLink.layout(model.n, len(model.wrists)))
        job: dict[str, object] = {"link": name, "law": law, "cell": cell.model_dump(mode="json")}
        job |= {"model_error": model_error, "groups": list(groups), "priority": priority, "paced": paced}
        self._process = ChildProcess.of_module("im_mcs.control.law_server", stdin=json.dumps(job))

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def await_ready(self, timeout_s: float) -> None:
        """Wait until the law is made.

        Raises:
            ConfigError: It cannot be made; its sentence.
            LinkError: It was not within ``timeout_s`` [s].
        """
        deadline = clock.monotonic() + timeout_s
        while not self._link.answer.wait(_POLL_S):
            if self._process.poll() is not None:
                raise ConfigError(self._link.fault or self._ending(), controller=self.law)
            if clock.monotonic() > deadline:
                raise LinkError(f"the process of control law '{self.law}' was not ready within {timeout_s:g} s")
        self._link.unlink()

    def idle(self, deadline: float) -> bool:
        """Return whether the law can be asked, possibly after a late answer, which is dropped.

        Args:
            deadline: Until when to wait [s of :func:`im_core.clock.monotonic`].

        Raises:
            ControlLawError: The late answer was a fault.
        """
        return not self._at_work or self.answer(deadline) is not None

    def ask(self, group: int, reset: bool, hold: int, carried: NDArray[np.float64], given: ControlInput) -> None:
        """Put a question (:meth:`LawLink.put_question`) to an :meth:`idle` law."""
        self._link.put_question(group, reset, hold, carried, given)
        self._at_work = True
        self._link.question.post()

    def answer(self, deadline: float) -> NDArray[np.float64] | None:
        """The answer, shape (n,), of which a group's joints are the first; None if the law is late.

        Raises:
            ControlLawError: The law failed.
        """
        if not self._link.answer.wait(max(0.0, deadline - clock.monotonic())):
            return None
        self._at_work = False
        if fault := self._link.fault:
            raise ControlLawError(fault, controller=self.law)
        return np.array(self._link.view["tau"])

    def check(self) -> None:
        """Look whether the process lives.

        Raises:
            ControlLawError: It does not.
        """
        if self._process.poll() is not None:
            raise ControlLawError(self._ending(), controller=self.law, pid=self.pid)

    def close(self) -> None:
        """End the process, by force if unresponsive."""
        if self._process.poll() is None:
            self._link.view["end"][()] = True
            self._link.question.post()
            if not self._process.await_end(_END_S):
                self._process.stop()
        self._link.close()

    def _ending(self) -> str:
        code = self._process.poll() or 0
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return f"the process of control law '{self.law}' (pid {self.pid}) {how}"


class RemoteLaw:
    """The law of one group in a :class:`LawProcess`; a :class:`im_mcs.control.Controller` like any other.

    Late torques are those of the last answer with the gravity of now in place of the gravity of then. The next
    question waits until the law has ended the last one, so that it never sees half of each.

    Args:
        process: Where the law is.
        group: Which of the process's groups.
        model: Whose payloads the law's model takes on.
        patience_s: How long a tick waits [s].
        max_late: Late answers in a row that are an error.

    Attributes:
        late: How many answers were late so far.
    """

    def __init__(
        self, process: LawProcess, group: int, model: ControlledModel, patience_s: float, max_late: int
    ) -> None:
        self.late = 0
        self._process, self._group, self._model = process, group, model
        self._patience_s, self._max_late = patience_s, max_late
        self._in_row = 0
        self._reset, self._hold = True, -1
        self._beyond_gravity: NDArray[np.float64] | float = 0.0

    def reset(self) -> None:
        """Start anew, with the next question."""
        self._reset, self._hold, self._in_row, self._beyond_gravity = True, -1, 0, 0.0

    def hold_integral(self, hold: bool) -> None:
        """Freeze or free accumulated terms, with the next question."""
        self._hold = int(hold)

    def command(self, given: ControlInput) -> NDArray[np.float64]:
        """Return torques for the current tick, shape (n,) [Nm or N].

        Raises:
            ControlLawError: The law failed, its process is gone, or it was late too often.
        """
        deadline = clock.monotonic() + self._patience_s
        answer = None
        if self._process.idle(deadline):
            self._process.ask(self._group, self._reset, self._hold, self._model.carried, given)
            self._reset, self._hold = False, -1
            answer = self._process.answer(deadline)
        if answer is None:
            self._excuse()
            return np.asarray(given.gravity + self._beyond_gravity)
        tau = answer[: len(given.q)]
        self._in_row, self._beyond_gravity = 0, tau - given.gravity
        return tau

    def _excuse(self) -> None:
        """Count a late answer, as long as there are not too many."""
        self._process.check()
        self.late += 1
        self._in_row += 1
        if self._in_row >= self._max_late:
            raise ControlLawError(
                f"control law '{self._process.law}', in process {self._process.pid}, gave no torques within "
                f"{1e3 * self._patience_s:.4g} ms in {self._in_row} ticks in a row",
                controller=self._process.law,
                pid=self._process.pid,
            )
