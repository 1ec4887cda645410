"""The operator of a node's nets: service ``/<node>/control_net``; and the values: ``/<node>/net_values``."""

import json
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

from im_core.errors import ImError, NotFoundError, StateError
from im_core.ros.node import ManagedNode
from im_msgs.srv import ControlNet, NetValues
from im_pnt.execution.events import (
    Answer,
    Answered,
    BreakpointSet,
    Confirmed,
    Event,
    ModeSet,
    Outcome,
    PauseSet,
    StepAsked,
)
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import ActivityState
from im_pnt.execution.operator import Mode
from im_pnt.execution.strategies import StrategyBook
from im_pnt.execution.token_values import values_of

REQUESTS = ("automatic", "supervised", "step", "pause", "resume", "confirm", "resolve", "break", "clear", "forget")


class ControlService:
    """Services for the operator of a net.

    Args:
        node: The node.
        nets: Its nets by name; looked at anew for each request.
        book: What was learned about its strategies.
        on_file: Has the nets go on with what was asked, and waits until that outlives this process; returns what the
            answer says where it does not.
    """

    def __init__(
        self,
        node: ManagedNode,
        nets: Mapping[str, Executor],
        book: StrategyBook,
        on_file: Callable[[], Coroutine[Any, Any, str]],
    ) -> None:
        self._nets, self._book, self._on_file = nets, book, on_file
        node.create_service(ControlNet, f"/{node.task_name}/control_net", self._control, urgent=True)
        node.create_service(NetValues, f"/{node.task_name}/net_values", self._values)

    async def _control(self, request: Any, response: Any) -> Any:
        try:
            executor = self._net(request.net)
            if request.request == "forget":
                return self._forget(executor, request.argument, response)
            event = _event(executor, request.request, request.argument)
        except (OSError, ImError) as error:
            response.success, response.message = False, str(error)
            return response
        executor.post(event)
        not_kept = await self._on_file()
        response.success = True
        response.message = f"{request.request} {request.argument}".strip() + not_kept
        paused = ", paused" if executor.paused else ""
        marked = ", ".join(f"{place}={count}" for place, count in executor.marking().items())
        response.state = f"{executor.operator.mode}{paused}: {marked}"
        return response

    def _forget(self, executor: Executor, argument: str, response: Any) -> Any:
        """Forget the experience with a strategy.

        Raises:
            NotFoundError: Nothing was.
            OSError: The file of the strategies cannot be written.
            StoreError: Likewise.
        """
        net = executor.written.name
        gone = self._book.forget(f"{net}.{argument}")
        if not gone:
            known = [name.removeprefix(f"{net}.") for name in self._book.learned if name.startswith(f"{net}.")]
            raise NotFoundError(kind="strategy with experience", name=argument, known=known)
        response.success, response.message = True, f"forgot {', '.join(gone)}"
        return response

    def _values(self, request: NetValues.Request, response: NetValues.Response) -> NetValues.Response:
        try:
            response.json = json.dumps(values_of(self._net(request.net), request.part))
            response.success = True
        except ImError as error:
            response.message = error.message
        return response

    def _net(self, name: str) -> Executor:
        if name not in self._nets:
            raise NotFoundError(kind="net", name=name, known=self._nets)
        return self._nets[name]


def _event(executor: Executor, request: str, argument: str) -> Event:
    """Return the event of a request to a net.

    Raises:
        NotFoundError: There is no such request, or no such transition.
        StateError: Nothing waits for it.
    """
    match request:
        case "step" if executor.operator.mode is Mode.STEP:
            if not executor.operator.may_step:
                why = "it is paused" if executor.operator.paused else "nothing is enabled that waits for one"
                raise StateError(f"net {executor.net.name} takes no step: {why}", net=executor.net.name)
            return StepAsked()
        case "automatic" | "supervised" | "step":
            return ModeSet(Mode(request))
        case "resume" if executor.paused and not executor.operator.paused:
            held = ", ".join(str(job.command.id) for job in executor.jobs() if executor.rule.is_held(job))
            raise StateError(f"net {executor.net.name} is not paused, but its commands {held} are; resume these")
        case "pause" | "resume":
            return PauseSet(request == "pause")
        case "confirm":
            return Confirmed(_proposed(executor.net.name, executor.proposed, argument))
        case "resolve":
            return _resolution(executor, argument)
        case "break" | "clear":
            if argument not in executor.written.transitions:
                raise NotFoundError(kind="transition", name=argument, known=executor.written.transitions)
            if request == "clear" and argument not in executor.breakpoints:
                raise NotFoundError(kind="breakpoint", name=argument, known=executor.breakpoints)
            return BreakpointSet(argument, request == "break")
    raise NotFoundError(kind="request to a net", name=request, known=REQUESTS)


def _proposed(net: str, waiting: tuple[str, ...], transition: str) -> str:
    if not waiting:
        raise StateError(f"nothing waits to be confirmed in net {net}", net=net)
    if not transition and len(waiting) > 1:
        raise StateError(f"several transitions wait to be confirmed: {', '.join(waiting)}; name one")
    if transition and transition not in waiting:
        raise NotFoundError(kind="transition that waits to be confirmed", name=transition, known=waiting)
    return transition or waiting[0]


def _resolution(executor: Executor, argument: str) -> Answered:
    transition, _, outcome = argument.partition("=")
    doubtful = {a.transition: a for a in executor.activities if a.state is ActivityState.IN_DOUBT}
    if transition not in doubtful:
        raise NotFoundError(kind="action in doubt", name=transition, known=doubtful)
    if outcome not in ("done", "failed"):
        raise NotFoundError(kind="outcome of an action", name=outcome, known=("done", "failed"))
    if outcome == "done":
        return Answered(doubtful[transition], Answer(Outcome.DONE, asked="the operator"))
    error = ImError(f"the operator says that {doubtful[transition].action} has failed", code="operator")
    return Answered(doubtful[transition], Answer(Outcome.FAILED, error, asked="the operator"))
