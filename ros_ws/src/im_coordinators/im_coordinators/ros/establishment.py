"""Establishments for a command, valid in one incarnation of the keeping task: power and slots of ``/mcs``, a light."""

from std_msgs.msg import UInt64

from im_core import clock
from im_core.errors import BEGUN_ANEW, StateError, WaitTimeoutError
from im_pnt.execution.functions import ActionContext
from im_pnt_node.rerun.host import Host

HEARD_S, PAUSE_S = 10.0, 0.02

FRESH_S = 1.0
"""How long one who has begun anew has to say how it is now [s]: what it said in its former incarnation is heard until
then."""


class Establishment:
    """Record of a task's incarnation at an establishment for a command, kept in a data object of the command.

    Args:
        host: The coordinator, or what stands for it.
        task: Who keeps what is established; empty: a driver that is no task, and is taken to live on.
        what: Begins the name of the data object, such as ``powered``.
    """

    def __init__(self, host: Host, task: str, what: str) -> None:
        self._host, self._task, self._what = host, task, what

    async def note(self, ctx: ActionContext, name: str) -> None:
        """Note an establishment for a command, with the task's incarnation; call before, to miss no death of the task.

        Args:
            ctx: What is done.
            name: Of what, such as ``left``.

        Raises:
            WaitTimeoutError: The task is not heard.
        """
        await self._host.dom.put(self._object(ctx, name), UInt64(data=await self._incarnation()))

    async def require(self, ctx: ActionContext, name: str) -> None:
        """Check the establishment of a command for loss; a command without an establishment may go on.

        Raises:
            StateError: It went with the incarnation in which it was; of code ``BEGUN_ANEW``.
            WaitTimeoutError: The task is not heard.
        """
        if not await self._host.dom.is_valid(noted := self._object(ctx, name)):
            return
        if (await self._host.dom.get(noted, UInt64)).data != await self._incarnation():
            await self._host.pause(FRESH_S)  # nets establish it again, and look at its state for that
            since = f"has begun anew since {name} was {self._what} for this command, and knows nothing of that"
            raise StateError(
                f"{self._task} {since}", code=BEGUN_ANEW, task=self._task, established=f"{self._what}/{name}"
            )

    async def forget(self, ctx: ActionContext, name: str) -> None:
        """Note the end of the establishment."""
        if await self._host.dom.is_valid(noted := self._object(ctx, name)):
            await self._host.dom.invalidate(noted)

    def _object(self, ctx: ActionContext, name: str) -> str:
        return ctx.object(f"{self._what}/{name}")

    async def _incarnation(self) -> int:
        """Return the present incarnation of the task; a coordinator just started waits for the first heartbeat."""
        if not self._task:
            return 0
        deadline = clock.monotonic() + HEARD_S
        while (incarnation := self._host.incarnation(self._task)) is None:
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=f"the heartbeat of {self._task}", seconds=HEARD_S)
            await self._host.pause(PAUSE_S)
        return incarnation
