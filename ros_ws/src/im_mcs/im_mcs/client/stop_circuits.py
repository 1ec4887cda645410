"""The second way to the power: the stop circuits of all channel drivers, for whoever owns the servo."""

from collections.abc import Callable, Mapping

from im_core.errors import LinkError
from im_mcs.limits.slots import Driver
from im_mcs.testbed.driver import StopCircuit, find_stop_circuit


class StopCircuits:
    """Cuts and restores all of them.

    Args:
        drivers: Of the configuration, by name.
        instance: Which machine on this host.
    """

    def __init__(self, drivers: Mapping[str, Driver], instance: str) -> None:
        found = {name: find_stop_circuit(spec.driver, instance) for name, spec in drivers.items()}
        self._circuits = {name: circuit for name, circuit in found.items() if circuit is not None}
        self._without = [name for name, circuit in found.items() if circuit is None]

    def cut(self) -> str:
        """Take the power away wherever that can be done; what has been done, as a sentence."""
        failed = self._each(lambda circuit: circuit.cut())
        done = [name for name in self._circuits if name not in failed]
        said = [f"the stop circuit of {', '.join(done)} is cut"] * bool(done)
        said += [f"that of {name} is not: {why}" for name, why in failed.items()]
        said += [f"{', '.join(self._without)} has no stop circuit"] * bool(self._without)
        return "; ".join(said)

    def restore(self) -> None:
        """Let the servo switch power on again; hardware that is not there comes back with its circuit whole."""
        self._each(lambda circuit: circuit.restore())

    def is_cut(self) -> bool:
        """Whether one is cut, perhaps since before this process."""
        cut: list[bool] = []
        self._each(lambda circuit: cut.append(circuit.is_cut()))
        return any(cut)

    def _each(self, act: Callable[[StopCircuit], None]) -> dict[str, str]:
        """Act on every circuit; why it failed, by driver."""
        failed: dict[str, str] = {}
        for name, circuit in self._circuits.items():
            try:
                act(circuit)
            except LinkError as error:
                failed[name] = error.message
        return failed
