"""Source of the groups' control laws: made in the servo process, or served by separate processes."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ConfigError, ImError
from im_core.processes.startup import patience_s
from im_mcs.control.controller import ControllerSetup
from im_mcs.control.guard import GuardedLaw, load_controller
from im_mcs.control.law_process import LawProcess, RemoteLaw
from im_mcs.control.laws import ControlLaws
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import ControlledModel

_UNPACED_PATIENCE_S = 0.1


class LawSource:
    """Makes the laws of any group of any preset; starts the processes at once, none later.

    A loop without deadlines waits longer for a law than one tick could, so that a run repeats.

    Args:
        config: Configuration.
        model: Dynamics in the eyes of the laws.
        torque_limit: Largest torques of all joints, shape (n,) [Nm or N].
        wall_period_s: Wall time between ticks [s]; 0: the loop has no deadlines.

    Raises:
        ConfigError: A law of its own process cannot be made, the cell lacks masses or largest torques, or
            these do not hold the arms at home.
        LinkError: Its process was not ready in time.
    """

    def __init__(
        self, config: McsConfig, model: ControlledModel, torque_limit: NDArray[np.float64], wall_period_s: float
    ) -> None:
        if (driven := list(config.ranks_of("effort"))) and (unknown := model.cell.unknown):
            raise ConfigError(f"a law that gives torques needs what the cell does not say: {'; '.join(unknown)}")
        holding = np.abs(model.gravity(model.cell.home))
        for rank in driven:
            if holding[rank] > torque_limit[rank]:
                told = f"joint {model.names[rank]} gives up to {torque_limit[rank]:g}, and needs {holding[rank]:.3g}"
                raise ConfigError(f"{told} to hold the arm at home [Nm or N]", joint=model.names[rank])
        self._config, self._model, self._torque_limit = config, model, torque_limit
        self._patience_s = config.law_processes.patience * wall_period_s or _UNPACED_PATIENCE_S
        self._groups = [(preset, name) for preset, groups in config.presets.items() for name in groups]
        self._remote: dict[tuple[str, str, str], RemoteLaw] = {}
        self._processes: dict[str, LawProcess] = {}
        try:
            for law in config.law_processes.laws:
                self._processes[law] = self._start(law, paced=wall_period_s > 0.0)
            for process in self._processes.values():
                process.await_ready(patience_s())
        except ImError:
            self.close()
            raise

    def laws_for(self, preset: str, group: str) -> ControlLaws:
        """The laws of a group, of which the configuration's first one is in force.

        Raises:
            ConfigError: One cannot be loaded.
        """
        first = self._config.control_of(group).controller
        setup, configured = self._setup(preset, group), self._config.parameters_of_laws(group)

        def make(law: str, parameters: Mapping[str, Any]) -> GuardedLaw:
            return load_controller(law, ControllerSetup(**setup, parameters={**configured[law], **parameters}))

        laws: dict[str, GuardedLaw | RemoteLaw] = {}
        for law in configured:
            laws[law] = self._connect(law, preset, group) if law in self._processes else make(law, {})
        config = self._config
        return ControlLaws(laws, first, config.servo.period_s, config.switching.handover_s, self._model, make)

    @property
    def late(self) -> dict[str, int]:
        """Late answers so far of each law with a separate process."""
        counts = dict.fromkeys(self._processes, 0)
        for (law, _, _), remote in self._remote.items():
            counts[law] += remote.late
        return counts

    def close(self) -> None:
        """End the processes."""
        for process in self._processes.values():
            process.close()
        self._processes.clear()

    def _start(self, law: str, paced: bool) -> LawProcess:
        config = self._config
        groups = []
        for preset, group in self._groups_of(law):
            setup = self._setup(preset, group)
            groups.append(
                {
                    "joints": setup["joints"].tolist(),
                    "period_s": setup["period_s"],
                    "torque_limit": setup["torque_limit"].tolist(),
                    "parameters": config.parameters_of_laws(group)[law],
                }
            )
        return LawProcess(law, self._model.cell, config.model_error, groups, config.servo.priority, paced)

    def _connect(self, law: str, preset: str, group: str) -> RemoteLaw:
        key = (law, preset, group)
        if key not in self._remote:
            number = self._groups_of(law).index((preset, group))
            patience_s = self._patience_s / len(self._config.presets[preset])  # groups are asked one after the other
            max_late = self._config.law_processes.max_late
            self._remote[key] = RemoteLaw(self._processes[law], number, self._model, patience_s, max_late)
        return self._remote[key]

    def _groups_of(self, law: str) -> list[tuple[str, str]]:
        return [(preset, group) for preset, group in self._groups if law in self._config.parameters_of_laws(group)]

    def _setup(self, preset: str, group: str) -> dict[str, Any]:
        joints = self._config.presets[preset][group].joints
        index = np.array([self._model.index(joint) for joint in joints], dtype=np.intp)
        return {
            "joints": index,
            "period_s": self._config.servo.period_s,
            "model": self._model,
            "torque_limit": self._torque_limit[index],
            "q_nominal": self._model.cell.home,
        }
