"""Nets that are loaded at run time: verified, alone and together, then switched when the present one is at rest."""

from collections.abc import Mapping
from dataclasses import replace

from im_core.clock import monotonic
from im_core.errors import StateError
from im_core.ros.calls import pause, run_in_thread
from im_core.ros.node import ManagedNode
from im_pnt.analysis.report import Report
from im_pnt.errors import NetError, VerificationError
from im_pnt.executive import Executive
from im_pnt.net import Net
from im_pnt.ros.library import Library
from im_pnt.ros.publish import PntPublisher

REST_CHECK_S = 0.02


class Loader:
    """Finds out whether a net may run, and waits until it may take its place.

    Args:
        node: The node.
        library: Knows the other nets.
        nets: Those of the node by name; looked at anew for each net.
        publisher: Shows why a net was refused.
    """

    def __init__(
        self, node: ManagedNode, library: Library, nets: Mapping[str, Executive], publisher: PntPublisher
    ) -> None:
        self._node, self._library, self._nets, self._publisher = node, library, nets, publisher

    async def prepare(self, net: Net, patience_s: float) -> tuple[Report, dict[str, object] | None]:
        """Verifies a net, alone and with those it talks to, and waits until the present one of its name is at rest.

        Args:
            net: The net.
            patience_s: Longest wait for that [s].

        Returns:
            The report, and the state that it takes over, if any; the net is to take its place at once.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It does not fit to the present marking.
            StateError: The present net of that name does not come to rest; says what keeps it.
        """
        report = await self._verified(net)
        present = self._nets.get(net.name)
        if present is None:
            return report, None
        await self._until_rest(present, patience_s)
        carried = carried_over(present, net)
        if carried is net:
            return report, None
        report = await self._verified(carried)
        await self._until_rest(present, patience_s)
        if carried_over(present, net) != carried:
            raise StateError(f"net {net.name} went on while its successor was verified; load it again")
        return report, present.state()

    async def _verified(self, net: Net) -> Report:
        own = [executive.written for executive in self._nets.values()]
        together = [net, *self._library.partners(net, own)]
        for nets in ([net], together) if len(together) > 1 else ([net],):
            report = await run_in_thread(self._node, self._library.verify, nets)
            try:
                report.require_ok()
            except VerificationError as error:
                self._publisher.refused(net.name, error.message, nets, report)
                raise
        return report

    async def _until_rest(self, executive: Executive, patience_s: float) -> None:
        deadline = monotonic() + patience_s
        while not (rest := executive.at_rest()):
            if monotonic() > deadline:
                name = executive.net.name
                text = f"net {name} is not at rest and cannot be replaced now: {rest}"
                raise StateError(text, net=name, reasons=list(rest.reasons))
            await pause(self._node, REST_CHECK_S)


def carried_over(executive: Executive, net: Net) -> Net:
    """Returns a net with the tokens of the one at rest whose place it takes; as it is, if that one is as it began.

    Raises:
        NetError: A place that is marked is not in the new net.
    """
    marking = executive.marking()
    if marking == executive.net.initial_marking():
        return net
    structure = executive.net.places.keys() - executive.written.places.keys()
    missing = [f"{place}={count}" for place, count in marking.items() if place not in {*net.places, *structure}]
    if missing:
        raise NetError(
            f"net {net.name} cannot take the place of the present one, which holds {', '.join(missing)}: "
            "it has no such place",
            net=net.name,
        )
    places = {
        name: replace(place, tokens=marking.get(name, 0)) if name in executive.net.places else place
        for name, place in net.places.items()
    }
    return replace(net, places=places)
