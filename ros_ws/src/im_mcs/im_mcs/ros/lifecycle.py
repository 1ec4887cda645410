"""Lifecycle interface of a node with slow transitions."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from lifecycle_msgs.msg import State, Transition, TransitionDescription, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import TransitionCallbackReturn

from im_core.errors import ImError, StateError
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_mcs.ros.bounds import check_bounds

Work = Callable[[str], Awaitable[None]]
"""Work of a transition, for a client (:func:`.client_of`); empty: for the node itself."""


class Lifecycle:
    """The state machine of rcl, the five services and ``transition_event``, driven by coroutines.

    ``rclpy.lifecycle.LifecycleNode`` runs transitions as blocking callbacks; here a transition awaits its work, so that
    the node goes on meanwhile. Its services are made by rcl and cannot tell what they are asked; these are the node's.

    Args:
        node: The node whose lifecycle this is.
        work: Coroutine function of each transition, by the label of the transition (``configure``, ``cleanup``,
            ``activate``, ``deactivate``, ``shutdown``); it raises :class:`ImError` if it cannot be done.

    Attributes:
        failure: Why the transition that was tried last failed; empty if it succeeded.
    """

    def __init__(self, node: ManagedNode, work: Mapping[str, Work]) -> None:
        self._node = node
        self._work = work
        self.failure = ""
        with node.handle:
            self._machine = _rclpy.LifecycleStateMachine(node.handle, False)
        self._events = node.create_publisher(TransitionEvent, "~/transition_event", qos.EVENTS)
        node.create_service(ChangeState, "~/change_state", self._change_state)
        node.create_service(GetState, "~/get_state", self._get_state)
        node.create_service(GetAvailableStates, "~/get_available_states", self._get_states)
        node.create_service(GetAvailableTransitions, "~/get_available_transitions", self._get_transitions)
        node.create_service(GetAvailableTransitions, "~/get_transition_graph", self._get_graph)

    @property
    def state(self) -> str:
        """Label of the present state."""
        return str(self._machine.current_state[1])

    async def change(self, transition: str, client: str = "") -> None:
        """Go through a transition with the work; after a failure, log and :attr:`failure` give the reason.

        Args:
            transition: ``configure``, ``cleanup``, ``activate``, ``deactivate`` or ``shutdown``.
            client: Who asks.

        Raises:
            StateError: The present state has no such transition.
            ImError: The work could not be done; the state is as before.
        """
        try:
            self._begin(self._id_of(transition))
            await self._carry_out(transition, client)
        except ImError as error:
            self.failure = f"the lifecycle transition {transition} failed: {error.message}"
            self._node.get_logger().error(self.failure)
            raise
        self.failure = ""

    def follow(self, transition: str) -> None:
        """Go through a transition with the work already done."""
        self._begin(self._id_of(transition))
        self._end(TransitionCallbackReturn.SUCCESS)
        self.failure = ""

    def destroy(self) -> None:
        """Let go of the node."""
        self._machine.destroy_when_not_in_use()

    async def _carry_out(self, transition: str, client: str) -> None:
        try:
            await self._work[transition](client)
        except Exception:  # a transition that does not end would be under way for good
            self._end(TransitionCallbackReturn.FAILURE)
            raise
        self._end(TransitionCallbackReturn.SUCCESS)

    def _begin(self, transition_id: int) -> None:
        self._go(self._machine.trigger_transition_by_id, transition_id)

    def _end(self, outcome: TransitionCallbackReturn) -> None:
        self._go(self._machine.trigger_transition_by_label, outcome.to_label())

    def _go(self, trigger: Callable[[Any, bool], None], which: int | str) -> None:
        """Go from one state to another, and publish the event."""
        taken = next(each for each in self._machine.available_transitions if which in each[:2])
        trigger(which, False)  # the machine itself tells nothing
        way = _description(taken)
        self._events.publish(
            TransitionEvent(
                timestamp=self._node.get_clock().now().nanoseconds,
                transition=way.transition,
                start_state=way.start_state,
                goal_state=way.goal_state,
            )
        )

    def _id_of(self, transition: str) -> int:
        # while one is under way, those with which it can end are available; they are not a client's to ask for
        known = {label: number for number, label, *_ in self._machine.available_transitions if label in self._work}
        if transition not in known:
            raise StateError(
                f"the lifecycle transition '{transition}' is not possible in state {self.state}; "
                f"possible: {', '.join(known) or 'none'}",
                state=self.state,
                request=transition,
            )
        return int(known[transition])

    def _change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> Callable[[str], Awaitable[ChangeState.Response]]:
        labels = {number: label for number, label, *_ in self._machine.available_transitions}
        label = request.transition.label or labels.get(request.transition.id) or _LABELS.get(request.transition.id, "")

        async def answer(client: str) -> ChangeState.Response:
            try:
                check_bounds(request, 0)
                await self.change(label, client)
                response.success = True
            except ImError:  # told where the reason has room: in the log and on /diagnostics
                response.success = False
            return response

        return answer

    def _get_state(self, _: object, response: GetState.Response) -> GetState.Response:
        response.current_state.id, response.current_state.label = self._machine.current_state
        return response

    def _get_states(self, _: object, response: GetAvailableStates.Response) -> GetAvailableStates.Response:
        response.available_states = [State(id=n, label=label) for n, label in self._machine.available_states]
        return response

    def _get_transitions(
        self, _: object, response: GetAvailableTransitions.Response
    ) -> GetAvailableTransitions.Response:
        response.available_transitions = [_description(t) for t in self._machine.available_transitions]
        return response

    def _get_graph(self, _: object, response: GetAvailableTransitions.Response) -> GetAvailableTransitions.Response:
        response.available_transitions = [_description(t) for t in self._machine.transition_graph]
        return response


_LABELS = {
    Transition.TRANSITION_CONFIGURE: "configure",
    Transition.TRANSITION_CLEANUP: "cleanup",
    Transition.TRANSITION_ACTIVATE: "activate",
    Transition.TRANSITION_DEACTIVATE: "deactivate",
}


def _description(transition: tuple[int, str, int, str, int, str]) -> TransitionDescription:
    number, label, start_id, start_label, goal_id, goal_label = transition
    return TransitionDescription(
        transition=Transition(id=number, label=label),
        start_state=State(id=start_id, label=start_label),
        goal_state=State(id=goal_id, label=goal_label),
    )
