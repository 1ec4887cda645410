"""``recover``: brings the running machine back after the death of the servo, the testbed or ``/mcs``.

Tasks that die or fail are started again by the agent of their host. What then is left to do is done here, over the
standard interfaces of ``/mcs``: configure it, reset its emergency stop, and if neither helps have it started again.
Nothing moves, and no power is switched on.
"""

import sys
from collections.abc import Callable, Container

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_srvs.srv import Trigger

from im_bringup.machine.recovery import McsCondition, Step, next_step
from im_bringup.ros.client_output import DONE, FAILED
from im_bringup.ros.interruptible import InterruptibleNode, talk
from im_core import clock
from im_core.errors import ImError, StateError, WaitTimeoutError
from im_core.options import NumberParser, seconds
from im_core.output import complain
from im_core.ros import qos
from im_core.ros.latest import Latest
from im_core.ros.repeated_warnings import LINK
from im_core.ros.repeated_warnings import PERIOD_S as REMINDED_S
from im_msgs.msg import McsState, TaskRegistry

TIMEOUT_S = 60.0
#: How long /mcs may be silent, and a call of it may take [s]; how long what does not answer may still come by itself.
SILENCE_S = 3.0
CALL_S = 30.0
PATIENCE_S = 6.0
_POLL_S = 0.1
#: How long every node has to say that no message reaches another [s]; what it has not repeated for so long is over.
_LINKS_S = 3.0 * REMINDED_S
_SERVO = "mcs: servo"


class RecoverClient(InterruptibleNode):
    """Client: takes the steps of :func:`im_bringup.machine.recovery.next_step` until the machine is ready.

    Args:
        say: Takes one sentence at a time: what was found, and what is done about it.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__("recover")
        self._registry: TaskRegistry | None = None
        self.create_subscription(TaskRegistry, "/bootstrap/tasks", self._register, qos.LATCHED)
        self._mcs = Latest(self, McsState, "/mcs/state", qos.LATCHED, SILENCE_S)
        self._diagnosed = False
        self._faulty = False
        self._links: dict[str, tuple[float, str]] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, qos.EVENTS)
        self._lifecycle = self.create_client(ChangeState, "/mcs/change_state")
        self._reset = self.create_client(Trigger, "/mcs/reset")
        self._mcs_pid = 0
        self._failure = ""
        self._tell, self._said = say, set[str]()

    def recover(self, timeout_s: float) -> str:
        """Bring the machine back.

        Args:
            timeout_s: Longest wait for it to be ready [s] of wall time.

        Returns:
            A sentence that says what there is now.

        Raises:
            KeyboardInterrupt: :meth:`interrupt` was called.
            StateError: A task was given up.
            WaitTimeoutError: The machine is not ready in time; says what is missing.
        """
        began = clock.monotonic()
        settled = began
        while True:
            now = clock.monotonic()
            tasks = self._tasks()
            step = next_step(tasks, self._condition(), patient=now - settled < PATIENCE_S)
            unreached = self._unreached(tasks)
            if step is Step.DONE and now - began > _LINKS_S and not unreached:
                return self._summary(tasks)
            for text in unreached:
                self._say(text)
            if now - began > timeout_s:
                raise WaitTimeoutError(what=f"the machine to be ready ({self._missing(tasks)})", seconds=timeout_s)
            if any(word != "ready" for word in tasks.values()):
                settled = now
            if step is Step.RESTART:
                settled = now
            self._take_step(step)
            self.pause(_POLL_S)

    def _tasks(self) -> dict[str, str]:
        """How far each task is.

        Raises:
            StateError: One was given up.
        """
        registered = [] if self._registry is None else self._registry.tasks
        for task in registered:
            if "given up" in task.detail:
                raise StateError(f"{task.name} {task.detail}; start anew: scripts/stop.sh, scripts/start.sh")
            if task.phase != "ready":
                self._say(f"{task.name} is {task.phase}{': ' + task.detail if task.detail else ''}")
        self._mcs_pid = next((task.pid for task in registered if task.name == "mcs"), 0)
        return {task.name: task.phase for task in registered}

    def _condition(self) -> McsCondition | None:
        message = self._mcs.message
        if message is None or not self._diagnosed:
            return None
        return McsCondition(message.state, message.reason, self._mcs.stale, self._faulty)

    def _take_step(self, step: Step) -> None:
        """Take a step; keep the failure, since the next attempt may succeed."""
        message = self._mcs.message
        if message is None or step in (Step.WAIT, Step.DONE):
            return
        self._say(f"MCS is {message.state}{': ' + message.reason if message.reason else ''}; {step.value}")
        try:
            if step is Step.RESET or not self._change_state(step.value):  # an emergency stop may be latched
                answer = self.ask(self._reset, Trigger.Request(), CALL_S)
                self._failure = "" if answer.success else answer.message
        except ImError as error:
            self._failure = error.message
        self._mcs.forget()
        self._diagnosed = False

    def _change_state(self, label: str) -> bool:
        """Request a lifecycle transition; return whether the transition was done.

        Raises:
            WaitTimeoutError: No answer.
        """
        request = ChangeState.Request(transition=Transition(label=label))
        answer = self.ask(self._lifecycle, request, CALL_S)
        return bool(answer.success)

    def _missing(self, tasks: dict[str, str]) -> str:
        waiting = [f"{name} is {word}" for name, word in tasks.items() if word != "ready"]
        waiting += self._unreached(tasks)
        if waiting or not tasks:
            return ", ".join(waiting) or "the bootstrap does not answer"
        message, pid = self._mcs.message, self._mcs_pid
        if message is None or self._mcs.stale:
            return f"/mcs does not answer; after 'kill -9 {pid}' the machine starts it again"
        reason = self._failure or message.reason
        return f"MCS is {message.state}{': ' + reason if reason else ''}"

    def _unreached(self, tasks: Container[str]) -> list[str]:
        """Return the nodes' statements on tasks out of reach of the nodes' messages."""
        now = clock.monotonic()
        told = [(name.partition(LINK)[2], at, text) for name, (at, text) in [*self._links.items()]]
        return [text for node, at, text in told if node in tasks and now - at < _LINKS_S]

    def _summary(self, tasks: dict[str, str]) -> str:
        state = f", MCS is {self._mcs.message.state}" if self._mcs.message is not None else ""
        return f"ready: {len(tasks)} tasks{state}"

    def _say(self, sentence: str) -> None:
        if sentence not in self._said:
            self._said.add(sentence)
            self._tell(sentence)

    def _register(self, message: TaskRegistry) -> None:
        self._registry = message

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if LINK in status.name:
                self._links[status.name] = clock.monotonic(), status.message
            if status.name == _SERVO:
                self._diagnosed, self._faulty = True, status.level == DiagnosticStatus.ERROR


def main() -> int:
    """Run the command."""
    parser = NumberParser(
        prog="im recover",
        description="Bring the running machine back after the death of its servo, its testbed or /mcs. Tasks that died "
        "are started again by the machine; this waits for them, configures /mcs, resets an emergency stop (and says "
        "what caused it), and if neither helps has /mcs started again. Nothing moves, no power is switched on.",
        epilog="Exit codes: 0 ready, 1 not ready (said what is missing), 2 bad usage, 3 no machine runs, "
        "130 interrupted.",
    )
    parser.add_argument("--timeout", type=seconds, default=TIMEOUT_S, help="longest wait in s (default: %(default)g)")
    arguments = parser.parse_args()

    def use(client: RecoverClient) -> int:
        try:
            print(f"recover: {client.recover(arguments.timeout)}")
        except ImError as error:
            complain(f"recover: {error.message}")
            return FAILED
        return DONE

    return talk(lambda: RecoverClient(lambda sentence: print(f"recover: {sentence}", flush=True)), use, "recover")


if __name__ == "__main__":
    sys.exit(main())
