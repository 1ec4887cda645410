"""The second way to the power: the stop circuits of all channel drivers, for node and servo process."""

from collections.abc import Callable, Mapping
from typing import TypeVar

from im_core.errors import LinkError
from im_mcs.limits.slots import Driver
from im_mcs.testbed.driver import PowerReading, StopCircuit, find_stop_circuit

Answer = TypeVar("Answer")


class StopCircuits:
    """Cut, restore and read all stop circuits; fit for several threads."""

    def __init__(self, drivers: Mapping[str, Driver], instance: str) -> None:
        found = {name: find_stop_circuit(spec.driver, instance) for name, spec in drivers.items()}
        self._circuits = {name: circuit for name, circuit in found.items() if circuit is not None}
        self._without = [name for name, circuit in found.items() if circuit is None]

    def cut(self) -> str:
        """Cut the power wherever a circuit reaches; return the actions done, as a sentence."""
        done, failed = self._each(lambda circuit: circuit.cut())
        said = [f"the stop circuit of {', '.join(done)} is cut"] * bool(done)
        said += [f"that of {name} is not: {why}" for name, why in failed.items()]
        said += [f"{', '.join(self._without)} has no stop circuit"] * bool(self._without)
        return "; ".join(said)

    def restore(self) -> None:
        """Let the servo switch power on again; missing hardware comes back with the circuit whole."""
        self._each(lambda circuit: circuit.restore())

    def is_cut(self) -> bool:
        """Return whether any circuit is cut, perhaps since before the process began."""
        return any(self._each(lambda circuit: circuit.is_cut())[0].values())

    def reading(self) -> PowerReading | None:
        """Read power and brakes of all hardware past the servo; None where a driver cannot say.

        Hardware that is not there has no power.
        """
        if self._without:
            return None
        readings = self._each(lambda circuit: circuit.reading())[0].values()
        return PowerReading(any(r.power for r in readings), all(r.braked for r in readings))

    def _each(self, act: Callable[[StopCircuit], Answer]) -> tuple[dict[str, Answer], dict[str, str]]:
        """Act on every circuit; return the answers, and why others failed, by driver."""
        answers: dict[str, Answer] = {}
        failed: dict[str, str] = {}
        for name, circuit in self._circuits.items():
            try:
                answers[name] = act(circuit)
            except LinkError as error:
                failed[name] = error.message
        return answers, failed
