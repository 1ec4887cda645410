"""Memory layout of the testbed link."""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from im_cell.link.fields import Fields
from im_cell.link.values import Drive, Faults, JawObject, Sensors
from im_cell.robot.objects import MAX_BODIES
from im_core.shm import Semaphore, SharedBlock

MAX_LIGHTS = 8

_FIXED = np.dtype(
    [
        ("n_joints", "<i8"),
        ("n_grippers", "<i8"),
        ("n_wrenches", "<i8"),
        ("period_ns", "<i8"),
        ("factor", "<f8"),
        ("seed", "<i8"),
        ("light_names", "S32", (MAX_LIGHTS,)),
    ],
    align=True,
)


def layout(n_joints: int, n_grippers: int, n_wrenches: int) -> np.dtype[np.void]:
    """Return the fields of the link; each field has one writer, named in the comments."""
    return np.dtype(
        [
            # physics
            ("sequence", "<u8"),
            ("tick", "<i8"),
            ("q", "<f8", (n_joints,)),
            ("power", "<i8"),
            ("brakes", "?", (n_joints,)),
            ("gripper", "<f8", (n_grippers,)),
            ("age_s", "<f8", (n_joints,)),
            ("wrench", "<f8", (n_wrenches, 6)),
            ("gripper_force", "<f8", (n_grippers,)),
            ("q_true", "<f8", (n_joints,)),
            ("v_true", "<f8", (n_joints,)),
            ("servo_losses", "<i8"),
            ("laser", "<f8", (4,)),
            ("bodies", "<f8", (MAX_BODIES, 7)),
            # servo; physics clears the pid of one that is gone
            ("servo_pid", "<i8"),
            ("servo_start", "<i8"),
            ("command_tick", "<i8"),
            ("command_command", "<f8", (n_joints,)),
            ("command_power", "<i8"),
            ("command_brakes", "?", (n_joints,)),
            ("command_gripper", "<f8", (n_grippers,)),
            ("command_gripper_force", "<f8", (n_grippers,)),
            ("command_wants_time", "<i8"),
            # one writer for each slot
            ("demand_until", "<i8", (3,)),
            # testbed node
            ("lights", "?", (MAX_LIGHTS,)),
            ("disturbances", "<i8"),  # odd while what follows is written
            ("fault_joints", "?", (4, n_joints)),
            ("fault_power", "<i8"),
            ("stall_s", "<f8"),
            ("objects", "<f8", (n_grippers, 3)),
            ("placements", "<i8", (MAX_BODIES,)),  # how often each body was placed
            ("placed", "<f8", (MAX_BODIES, 7)),
            # the emergency stop circuit
            ("stop", "<i8"),
            # whoever drives the laser scanner
            ("laser_command", "<f8", (4,)),
            # whoever has images taken at a rate; 0: none is due
            ("image_due", "<i8"),
            # cameras
            ("exposure_request", "<i8"),
            ("exposure_ticks", "<i8"),
            ("exposure_blank", "<i8"),
            ("exposure_blank_laser", "<i8"),
            # physics
            ("exposure_done", "<i8"),
            ("exposure_start", "<i8"),
            ("exposure_end", "<i8"),
            ("exposure_q", "<f8", (n_joints,)),
            ("exposure_light", "<f8", (MAX_LIGHTS,)),
            ("exposure_laser", "<f8", (4,)),
            ("exposure_bodies", "<f8", (MAX_BODIES, 7)),
            ("exposure_jaws", "<f8", (n_grippers,)),
        ],
        align=True,
    )


class LinkBlock:
    """Views of the fields (``view["q"]``; scalars have shape ()) and the four semaphores."""

    def __init__(self, instance: str, block: SharedBlock, semaphores: dict[str, Semaphore]) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.instance = instance
        self.block = block
        self._semaphores = semaphores
        self.state, self.command = semaphores["state"], semaphores["command"]
        self.wake, self.exposed = semaphores["wake"], semaphores["exposed"]
        fixed = block.array(_FIXED, 1).reshape(())
        self.n_joints = int(fixed["n_joints"])
        self.n_grippers, self.n_wrenches = int(fixed["n_grippers"]), int(fixed["n_wrenches"])
        self.period_ns = int(fixed["period_ns"])
        self.factor = float(fixed["factor"])
        self.seed = int(fixed["seed"])
        self.light_names = tuple(name.decode() for name in fixed["light_names"].tolist() if name)
        dtype = layout(self.n_joints, self.n_grippers, self.n_wrenches)
        record = block.array(dtype, 1, offset=_FIXED.itemsize).reshape(())
        self.view: dict[str, NDArray[Any]] = {name: record[name] for name in dtype.names or ()}
        self.sensed = self._fields(Sensors._fields)
        self.true = self._fields(("q_true", "v_true"))
        self.commanded = self._fields(tuple(f"command_{name}" for name in Drive._fields))

    @classmethod
    def create(
        cls,
        instance: str,
        counts: tuple[int, int, int],
        period_ns: int,
        factor: float,
        seed: int,
        lights: tuple[str, ...],
    ) -> Self:
        """Create block and semaphores; remains of a dead machine of the same instance are replaced.

        Args:
            instance: Name of the machine.
            counts: Numbers of joints, grippers and wrist sensors.
            period_ns: Time of a tick [ns].
            factor: Clock factor.
            seed: Of the testbed's random numbers.
            lights: Their names.

        Raises:
            LinkError: A living process of that instance owns the link.
        """
        block = SharedBlock.create(f"{instance}_testbed", _FIXED.itemsize + layout(*counts).itemsize)
        semaphores = {name: Semaphore.create(f"{instance}_testbed_{name}") for name in _SEMAPHORES}
        names = [name.encode() for name in lights] + [b""] * (MAX_LIGHTS - len(lights))
        block.array(_FIXED, 1)[0] = (*counts, period_ns, factor, seed, names)
        return cls(instance, block, semaphores)

    @classmethod
    def attach(cls, instance: str, timeout_s: float) -> Self:
        """Attach to a link with living physics.

        Raises:
            LinkError: There is none within ``timeout_s`` [s].
        """
        block = SharedBlock.attach(f"{instance}_testbed", timeout_s)
        semaphores = {name: Semaphore.attach(f"{instance}_testbed_{name}", timeout_s) for name in _SEMAPHORES}
        return cls(instance, block, semaphores)

    def _fields(self, names: tuple[str, ...]) -> Fields:
        return Fields([self.view[name] for name in names])

    def faults(self) -> Faults:
        """The faults in force."""
        nan, frozen, stuck, open_ = self.view["fault_joints"].copy()
        return Faults(nan, frozen, stuck, open_, bool(self.view["fault_power"]))

    def objects(self) -> tuple[JawObject | None, ...]:
        """Return the objects between the jaws of each gripper."""
        return objects_of(self.view["objects"].tolist())

    def lights(self) -> tuple[bool, ...]:
        """Which lights are switched on, in the order of ``light_names``."""
        return tuple(bool(on) for on in self.view["lights"][: len(self.light_names)])

    def close(self) -> None:
        """Release everything; the creator also removes the names."""
        self.view = {}
        self.sensed = self.true = self.commanded = Fields(())
        for semaphore in self._semaphores.values():
            semaphore.close()
        self.block.close()


def objects_of(rows: list[list[float]]) -> tuple[JawObject | None, ...]:
    """Return objects from width [m], stiffness [N/m] and mass [kg]; a width of 0 is no object."""
    return tuple(JawObject(*row) if row[0] else None for row in rows)


_SEMAPHORES = ("state", "command", "wake", "exposed")
