import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from im_cell.robot import Cell, load_cell, urdf
from im_mcs.limits.configuration import McsConfig, load_config
from im_mcs.model import CellModel
from im_mcs.protocol.channel import evidence_type
from im_mcs.protocol.evidence import KEPT, Recorder, Records
from im_mcs.servo.core import Mcs
from im_mcs.testbed import Drive, Measured, TestbedInterface
from im_mcs.testbed.loopback import LoopbackDriver
from im_sim.plant import Plant


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell()


@pytest.fixture(scope="session")
def config() -> McsConfig:
    return load_config()


@pytest.fixture(scope="session")
def model(cell: Cell) -> CellModel:
    return CellModel(cell)


def joint_path(*points: NDArray[np.float64]) -> dict[str, Any]:
    """The path of a move through points."""
    return {"kind": "joint", "points": [point.tolist() for point in points], "blend": 0.0}


class Bench:
    """MCS over a driver, with the requests and answers of a client."""

    def __init__(self, config: McsConfig, model: CellModel, driver: Any, **others: Any) -> None:
        self.events: list[dict[str, Any]] = []
        self.driver, self.drivers = driver, (driver, *others.values())
        clock = config.testbed.clock
        self.testbed = testbed = TestbedInterface({clock: driver, **others}, config.slots, clock)
        memory = np.zeros(KEPT, evidence_type(config))
        self.records = Records(memory)
        self.mcs = Mcs(config, model, testbed, self.events.append, Recorder(memory))
        self._number = 0

    def send(self, request: str, **arguments: Any) -> int:
        """Send a request in a tick of its own; its number."""
        self._number += 1
        self.mcs.tick([{"id": self._number, "request": request, "arguments": arguments}])
        return self._number

    def reply(self, number: int) -> dict[str, Any] | None:
        newest = reversed(self.events)
        return next((e for e in newest if e["event"] == "reply" and e["id"] == number), None)

    def ask(self, request: str, on_tick: Callable[[], None] = lambda: None, **arguments: Any) -> dict[str, Any]:
        """Send a request and let time pass until time is no longer wanted."""
        number = self.send(request, **arguments)
        on_tick()
        for _ in range(5000):
            if not self.mcs.wants_time:
                break
            self.mcs.tick([])
            on_tick()
        reply = self.reply(number)
        assert reply is not None
        return reply

    def move(self, group: str, point: NDArray[np.float64], **kwargs: Any) -> dict[str, Any]:
        return self.ask("move", group=group, path=joint_path(point), **kwargs)

    def to_motion(self, *groups: str) -> None:
        for group in groups:
            assert self.ask("reserve", group=group)["success"]
        for request in ("power_on", "enable_motion"):
            reply = self.ask(request)
            assert reply["success"], reply


@pytest.fixture
def frictionless(config: McsConfig) -> McsConfig:
    """For the loopback driver, which has no friction to be compensated, or to hold a joint at rest."""
    parameters = {
        **config.control.parameters,
        "rest_deadband": 1e-9,
        "feedforward": {"gravity": 1.0, "inertia": 1.0},
    }
    control = config.control.model_copy(update={"parameters": parameters})
    switching = config.switching.model_copy(update={"pair": ""})  # that law feeds forward friction
    return config.model_copy(update={"control": control, "switching": switching})


@pytest.fixture
def make_bench(model: CellModel, cell: Cell) -> Callable[..., Bench]:
    """Benches over the loopback driver."""

    def make(config: McsConfig, gravity: float = 1.0) -> Bench:
        """Make a bench whose arms weigh ``gravity`` times what the laws know."""
        interfaces = {slot.channel: slot.interface for slot in config.joint_slots}
        inertia, known = model.inertia_diagonal(cell.home), CellModel(cell)
        driver = LoopbackDriver(inertia, cell.home, bias=lambda q: gravity * known.gravity(q), interfaces=interfaces)
        return Bench(config, model, driver)

    return make


@pytest.fixture
def bench(frictionless: McsConfig, make_bench: Callable[..., Bench]) -> Bench:
    return make_bench(frictionless)


@pytest.fixture
def halves(frictionless: McsConfig, model: CellModel, cell: Cell) -> Bench:
    """A bench with the left side on the driver that is the clock, and the right side on another one."""

    def half(side: slice) -> LoopbackDriver:
        def bias(q: NDArray[np.float64]) -> NDArray[np.float64]:
            whole = cell.home.copy()
            whole[side] = q
            return CellModel(cell).gravity(whole)[side]

        return LoopbackDriver(model.inertia_diagonal(cell.home)[side], cell.home[side], bias=bias)

    places = [
        slot.model_copy(update={"driver": "other", "channel": slot.channel - 9})
        if slot.kind == "joint" and slot.channel >= 9
        else slot
        for slot in frictionless.slots
    ]
    config = frictionless.model_copy(update={"slots": tuple(places)})
    return Bench(config, model, half(slice(0, 9)), other=half(slice(9, 18)))


class LeftArm:
    """The left cart and arm with rotors, dry friction, encoders and brakes; the right side stands still.

    Time stepping with the friction impulses of all joints found by projected Gauss-Seidel.
    """

    n_joints, n_grippers, n_wrenches, wall_period_s = 18, 2, 2, 0.0

    def __init__(self, cell: Cell, seed: int) -> None:
        self.period_s = cell.period
        self._substeps = cell.substeps
        self._pin = pin.buildModelFromXML(urdf(cell, shapes=False))
        self._pin.gravity.linear = np.array([0.0, 0.0, -cell.gravity])
        self._pin.armature = cell.per_joint("rotor_inertia")
        self._data = self._pin.createData()
        self._cell = cell
        self._random = np.random.default_rng(seed)
        self.q, self.v = cell.home.copy(), np.zeros(18)
        self._drive = Drive(np.zeros(18), False, np.ones(18, dtype=np.bool_), np.zeros(2), False, np.zeros(2))
        self._friction = np.maximum(cell.per_joint("coulomb_positive"), cell.per_joint("coulomb_negative"))[:9]
        self._viscous = cell.per_joint("viscous")[:9]
        self._resolution, self._noise = cell.per_joint("resolution"), cell.per_joint("noise")
        self._tick = 0

    def connect(self) -> None: ...

    def after_tick(self, tick: int) -> None: ...

    def close(self) -> None: ...

    def wait(self, timeout_s: float) -> bool:
        return True

    def read(self) -> Measured:
        noisy = self.q + self._random.standard_normal(18) * self._noise
        reading = np.rint(noisy / self._resolution) * self._resolution
        braked = self._drive.brakes | (not self._drive.power)
        return Measured(
            self._tick, self._tick * 4_500_000, reading, self._drive.power, braked, np.zeros(2),
            np.zeros(18), np.full((2, 6), np.nan), np.zeros(2),
        )  # fmt: skip

    def write(self, drive: Drive) -> None:
        self._drive = drive
        self._tick += 1
        if drive.brakes[:9].any() or not drive.power:
            self.v[:] = 0.0
            return
        dt = self.period_s / self._substeps
        for _ in range(self._substeps):
            mass = np.triu(pin.crba(self._pin, self._data, self.q))[:9, :9]
            mass = mass + np.triu(mass, 1).T
            bias = pin.nonLinearEffects(self._pin, self._data, self.q, self.v)[:9]
            momentum = mass @ self.v[:9] + dt * (drive.command[:9] - bias - self._viscous * self.v[:9])
            self.v[:9] = _slide(mass, momentum, dt * self._friction)
            self.q = self.q + dt * self.v


def _slide(mass: NDArray[np.float64], momentum: NDArray[np.float64], bound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Velocities v with mass v = momentum + p, where |p| <= bound opposes v: projected Gauss-Seidel in p."""
    inverse = np.linalg.inv(mass)
    p = np.zeros(len(bound))
    v = inverse @ momentum
    for _ in range(60):
        change = 0.0
        for i in range(len(p)):
            new = min(max(p[i] - v[i] / inverse[i, i], -bound[i]), bound[i])
            if not math.isclose(new, p[i], abs_tol=1e-12):
                v = v + inverse[:, i] * (new - p[i])
                change = max(change, abs(new - p[i]) / bound[i])
                p[i] = new
        if change < 1e-6:
            break
    return v


@pytest.fixture
def arm_bench(config: McsConfig, model: CellModel, cell: Cell) -> Bench:
    return Bench(config, model, LeftArm(cell, seed=5))


class PlantDriver:
    """The simulated testbed's physics in this process, in lockstep."""

    wall_period_s = 0.0

    def __init__(self, cell: Cell, seed: int) -> None:
        self.n_joints, self.period_s = len(cell.joints), cell.period
        self.n_grippers, self.n_wrenches = len(cell.devices("gripper")), len(cell.devices("force"))
        self.plant = Plant(cell, seed)
        self._tick = 0

    def connect(self) -> None: ...

    def after_tick(self, tick: int) -> None: ...

    def wait(self, timeout_s: float) -> bool:
        return True

    def read(self) -> Measured:
        tick = self._tick
        s = self.plant.sensors(tick)
        return Measured(tick, tick * 4_500_000, s.q, s.power, s.brakes, s.gripper, s.age_s, s.wrench, s.gripper_force)

    def write(self, drive: Drive) -> None:
        self.plant.run_tick(drive)
        self._tick += 1

    def close(self) -> None:
        self.plant.close()


@pytest.fixture
def plant_bench(model: CellModel, cell: Cell) -> Iterator[Callable[[McsConfig, int], Bench]]:
    """Benches over the simulated testbed's physics, with friction and encoders."""
    made: list[PlantDriver] = []

    def make(config: McsConfig, seed: int) -> Bench:
        made.append(PlantDriver(cell, seed))
        return Bench(config, model, made[-1])

    yield make
    for driver in made:
        driver.close()


@pytest.fixture
def bench_of() -> Iterator[Callable[[str], Bench]]:
    """Benches over the physics of any shipped cell, by its name."""
    made: list[PlantDriver] = []

    def make(name: str) -> Bench:
        made.append(PlantDriver(cell := load_cell(name), seed=3))
        return Bench(load_config(cell=cell), CellModel(cell), made[-1])

    yield make
    for driver in made:
        driver.close()
