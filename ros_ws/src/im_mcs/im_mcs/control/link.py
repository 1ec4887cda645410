"""Shared memory between the servo loop and a control law in a separate process."""

import numpy as np
from numpy.typing import NDArray

from im_core.shm import Semaphore, SharedBlock, SharedRecord
from im_mcs.control.controller import ControlInput
from im_mcs.planning.trajectories.trajectory import Setpoint

_FAULT_BYTES = 600
_PARTS = ("q", "v", "a")


class LawLink(SharedRecord):
    """One question at a time: the servo, the creator, asks, the law answers; each wakes the other with a semaphore.

    Attributes:
        question: Posted by the servo when the fields hold a question.
        answer: Posted by the law when they hold its answer, and once when it is ready.
    """

    SEMAPHORES = ("question", "answer")

    @staticmethod
    def layout(n_joints: int, n_wrists: int) -> np.dtype[np.void]:
        """Return the fields of the link; a group of ``n`` joints uses the first ``n`` of those over all joints."""
        joints = (n_joints,)
        setpoints = [(f"{whose}_{part}", "<f8", joints) for whose in ("setpoint", "wanted_all") for part in _PARTS]
        return np.dtype(
            [
                # servo; not touched while the law is at work
                ("end", "?"),
                ("group", "<i8"),
                ("reset", "?"),
                ("hold", "<i8"),
                ("carried", "<f8", (n_wrists, 10)),
                ("q", "<f8", joints),
                ("v", "<f8", joints),
                ("gravity", "<f8", joints),
                ("q_all", "<f8", joints),
                *setpoints,
                # law
                ("tau", "<f8", joints),
                ("fault", f"S{_FAULT_BYTES}"),
            ],
            align=True,
        )

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void], semaphores: list[Semaphore]) -> None:
        super().__init__(block, dtype, semaphores)
        self.question, self.answer = semaphores

    def put_question(
        self, group: int, reset: bool, hold: int, carried: NDArray[np.float64], given: ControlInput
    ) -> None:
        """Write a question.

        Args:
            group: Which of the law's groups.
            reset: Whether the law starts anew before it.
            hold: 1 or 0 to freeze or free what accumulates before it; -1: neither.
            carried: Payloads (:attr:`im_mcs.model.ControlledModel.carried`).
            given: What the law sees.
        """
        view, n = self.view, len(given.q)
        view["group"][()], view["reset"][()], view["hold"][()] = group, reset, hold
        view["carried"][:] = carried
        for name in ("q", "v", "gravity", "q_all"):
            values = getattr(given, name)
            view[name][: len(values)] = values
        for part in _PARTS:
            view[f"setpoint_{part}"][:n] = getattr(given.setpoint, part)
            view[f"wanted_all_{part}"][:] = getattr(given.wanted_all, part)

    def given(self, n: int) -> ControlInput:
        """The question to a group of ``n`` joints; a copy."""
        view = self.view
        setpoint = Setpoint(*(view[f"setpoint_{part}"][:n].copy() for part in _PARTS))
        wanted = Setpoint(*(view[f"wanted_all_{part}"].copy() for part in _PARTS))
        q, v, gravity = (view[name][:n].copy() for name in ("q", "v", "gravity"))
        return ControlInput(q, v, setpoint, gravity, view["q_all"].copy(), wanted)

    @property
    def fault(self) -> str:
        """Fault of the law; empty: none."""
        return bytes(self.view["fault"][()]).decode(errors="replace")

    @fault.setter
    def fault(self, sentence: str) -> None:
        self.view["fault"][()] = sentence.encode()[:_FAULT_BYTES].decode(errors="ignore").encode()
