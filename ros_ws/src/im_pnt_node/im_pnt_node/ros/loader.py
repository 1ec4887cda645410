"""Loading of nets: verified alone and together, taken in when the present one is at rest, and taken out."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from functools import partial

from im_core.clock import monotonic
from im_core.errors import ImError, NotFoundError, StateError
from im_core.ros.calls import pause, run_in_thread
from im_core.ros.node import ManagedNode
from im_pnt.errors import JournalError, NetError, VerificationError
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import Functions
from im_pnt.execution.journal_entries import Record
from im_pnt.execution.succession import begin_succession, count_on, hand_over, hindrance_of_succession
from im_pnt.expression.scope import check_net
from im_pnt.model.net import Net
from im_pnt.netfile.schema.names import MAX_NAME
from im_pnt.verification import Verification, accept
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.journal.state import net_state, restore_net, taken_over
from im_pnt_node.ros.commands.commands import Commands
from im_pnt_node.ros.execution.endpoints import EndpointGoesError, require_one_type
from im_pnt_node.ros.execution.loop import NetLoop
from im_pnt_node.ros.execution.runner import NodeRunner
from im_pnt_node.ros.execution.transport import DdsTransport
from im_pnt_node.ros.library import Library
from im_pnt_node.ros.messages import RosTypes
from im_pnt_node.ros.objects.sources import Sources
from im_pnt_node.ros.reporting.mission import MissionPublisher
from im_pnt_node.ros.reporting.observer import NodeObserver

REST_CHECK_S = 0.02
TURN_S = 2.0
"""What has come to a net is taken in its next turn; so long that is waited for, by who has no patience, too [s]."""
ENDPOINT_GOES_S = 0.05
"""After so long the executor has let go of what a former net reached others with [s]."""


class Loader:
    """Loader of nets: verifies a net, waits until the net may take the place, and takes the net in or out.

    Args:
        node: The node.
        library: Knows the nets of other nodes.
        exchange: The nets in execution.
        functions: What nets name.
        runner: Has clients and subscriptions made for their actions.
        sources: What their guards look at.
        loop: Has them go on, and holds their journal.
        transport: Reaches the nodes of their partners.
        commands: Go over to the successor of a net.
        observer: Is told that a net is not proved; publishes nets, and why one was refused.
        mission: Is told of each net.
        make: Makes the executor of a net.
        recorder: Returns what records the events of a net of a name; None: there is no journal.

    Attributes:
        changed: Called when a net has come or gone.
    """

    def __init__(
        self,
        node: ManagedNode,
        library: Library,
        exchange: Exchange,
        functions: Functions,
        runner: NodeRunner,
        sources: Sources,
        loop: NetLoop,
        transport: DdsTransport,
        commands: Commands,
        observer: NodeObserver,
        mission: MissionPublisher,
        make: Callable[[Net], Executor],
        recorder: Callable[[str], Record | None],
    ) -> None:
        self._node, self._library, self._exchange, self._nets = node, library, exchange, exchange.nets
        self._functions, self._runner, self._sources, self._loop = functions, runner, sources, loop
        self._transport, self._commands, self._mission, self._make = transport, commands, mission, make
        self._observer, self._publisher, self._recorder = observer, observer.publisher, recorder
        self._formers: list[Executor] = []
        self.changed: Callable[[], None] = lambda: None

    def begin(self, nets: Sequence[Net]) -> None:
        """Take in the first nets, each verified alone.

        Raises:
            ImError: As of :meth:`load`.
        """
        for net in nets:
            self._take_in(net, self._library.verify([net]))
        self._prepare_partners()

    async def load(
        self,
        net: Net,
        patience_s: float,
        beside: Sequence[Net] = (),
        around: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> Verification:
        """Verify a net, alone and with the partners, and take the net into execution.

        Args:
            net: The net; it takes the place of one of the same name. Commands that have begun end in that one, as a
                former version under another name; where this cannot be, that one is to come to rest before.
            patience_s: Longest wait for that [s].
            beside: Nets that take the places of those of their names in the same turn; verified with it.
            around: Entered in that turn before it comes, where it may still be refused, and left when it has come.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It names a function that is not registered, or does not fit to the present marking.
            StateError: The present net of that name does not come to rest; says what keeps it, and why its commands
                cannot go on in a former version.
            WaitTimeoutError: ``/dom`` does not say whether the data objects are valid that its guards are woken by.
            JournalError: The journal cannot be written; all is as it was.
            ImError: What ``around`` raises.
        """
        await run_in_thread(self._node, self._functions.check, net)  # a user's module may take long to import
        wakes = self._functions.wakes(net)
        self._sources.check_topics(net.name, wakes)
        try:
            await self._sources.meet(wakes)  # before it comes: nobody has to wait for /dom with it
            report = await self._take_place(net, patience_s, beside, around)
        except ImError:
            self._keep_sources()
            raise
        self._library.tidy(self._written())
        self.changed()
        return report

    async def _take_place(
        self,
        net: Net,
        patience_s: float,
        beside: Sequence[Net],
        around: Callable[[], AbstractContextManager[None]],
    ) -> Verification:
        """Take in a verified net, once the present net of the name is at rest, or may be a former version."""
        while True:
            report, state = await self._prepare(net, patience_s, beside)
            former = self._nets.get(net.name)
            try:
                with around():
                    busy = former is not None and not former.at_rest()
                    enter = partial(self._retire, former) if former is not None and busy else None
                    self._take_in(self._library.kept(net), report, state, enter)
                    self._prepare_partners()
                    self._write_down(net.name, former)
            except EndpointGoesError:
                await pause(self._node, ENDPOINT_GOES_S)
            else:
                return report

    async def unload(
        self,
        name: str,
        patience_s: float = 0.0,
        beside: Sequence[Net] = (),
        around: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        """Take a net out of execution, and out of the journal, once the net is at rest.

        Args:
            name: Its name.
            patience_s: Longest wait for that [s].
            beside: Nets that take the places of those of their names in the same turn, and ask it no more.
            around: Entered in that turn before it goes, where it may still be refused, and left when it has gone.

        Raises:
            NotFoundError: There is none of that name.
            StateError: Another net of this node asks it, or it does not come to rest; says what keeps it.
            JournalError: The journal cannot be written; all is as it was.
            ImError: What ``around`` raises.
        """
        nets = self._nets
        if name not in nets:
            raise NotFoundError(kind="net", name=name, known=nets)
        left = {net: each.written for net, each in nets.items() if net != name}
        left |= {each.name: each for each in beside}
        asking = [net for net, each in left.items() if name in each.partners()]
        if asking:
            raise StateError(f"net {name} cannot go: {', '.join(asking)} asks it", net=name, askers=asking)
        await self._until_rest(nets[name], patience_s)
        with around():
            before = dict(nets)
            del nets[name]
            if self._loop.journal is not None:
                try:
                    self._loop.journal.compact()
                except (JournalError, NetError):
                    nets.clear()
                    nets.update(before)  # in the order in which they were
                    raise
            self._publisher.withdrawn(name)
            self._keep_sources()
        self.changed()

    def succeed(self, net: Net, report: Verification) -> None:
        """Replace a net in execution by another of the name, with the jobs.

        Data objects that only its guards are woken by count as not valid until ``/dom`` has answered.

        Raises:
            StateError: Something is under way in the present net that the new one does not have.
            JournalError: The journal cannot be written. It has taken the place all the same, and nothing leaves until
                that can be written.
        """
        present = self._nets[net.name]
        while self._loop.pump(present):
            pass
        state = taken_over(present, net)
        self._take_in(self._library.kept(net), report, state, self._exchange.succeed)
        self._prepare_partners()
        self._node.spawn(self._sources.look())
        self._nets[net.name].resume()
        self._commands.take_up()
        self.changed()
        if self._loop.journal is not None:
            self._loop.journal.renew()
        self._library.tidy(self._written())

    async def _prepare(
        self, net: Net, patience_s: float, beside: Sequence[Net] = ()
    ) -> tuple[Verification, dict[str, object] | None]:
        """Verify a net, alone and with the partners, and wait until the present net of the name is at rest.

        Args:
            net: The net.
            patience_s: Longest wait for that [s].
            beside: Nets that take the places of those of their names in the same turn.

        Returns:
            The report, and the state that it takes over, if any; the net is to take its place at once.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It does not fit to the present marking.
            StateError: The present net of that name does not come to rest; says what keeps it.
        """
        report = await self.verified(net, beside)
        present = self._nets.get(net.name)
        if present is None:
            return report, None
        await self._until_rest(present, patience_s, net)
        if not present.at_rest():
            return report, None
        context = carried_over(present, net)
        if context is net:
            return report, None
        report = await self.verified(context, beside)
        await self._until_rest(present, patience_s)
        if carried_over(present, net) != context:
            raise StateError(f"net {net.name} went on while its successor was verified; load it again")
        return report, net_state(present)

    def _write_down(self, name: str, former: Executor | None) -> None:
        """Write a new net into the journal, or take the net out again: a journal of other nets restores nothing.

        Raises:
            JournalError: The journal cannot be written; all is as it was.
            NetError: Likewise.
        """
        try:
            if self._loop.journal is not None:
                self._loop.journal.compact()
        except (JournalError, NetError):
            if former is None:
                del self._nets[name]
                self._publisher.withdrawn(name)
            else:
                if former in self._formers:
                    written = replace(former.written, name=name, former="")
                    self._forget(former)
                    self._exchange.rename(former, written, self._recorder(name))
                self._nets[name] = former
                self._publisher.described(former)
                self._publisher.marked(former)
            raise

    def _retire(self, former: Executor, executor: Executor) -> None:
        """Have a busy net go on as a former version of the successor.

        Raises:
            StateError: It cannot.
        """
        net, rule = former.written, former.rule
        while self._loop.pump(former):
            pass
        self._mission.publish()  # before the states: what has happened leads to them
        if why := self._hindrance(former, executor.written):
            raise StateError(f"net {net.name} is busy and cannot be replaced now: {why}", net=net.name)
        begin_succession(former, executor)
        # a number that no other version of the net gets: goals are known by it
        name = f"{net.name[: MAX_NAME - 40]}_former_{former.sequence + rule.ledger.count}"
        kept = self._library.kept(replace(net, name=name, former=net.name))
        self._exchange.rename(former, kept, self._recorder(name))
        self._nets[net.name] = executor
        self._formers.append(former)
        self._show(former)

    def _hindrance(self, executor: Executor, net: Net) -> str:
        """Return the reason against commands that go on in a former version of a net; empty: there is none."""
        former = self._former_of(executor)
        return former or hindrance_of_succession(executor, net)

    def _former_of(self, executor: Executor) -> str:
        """Return a clause about the former version of a net; empty: there is none."""
        names = [each.net.name for each in self._formers if each.written.former == executor.net.name]
        return f"its former version {names[0]} has not ended its commands" if names else ""

    def tidy(self) -> None:
        """Hand over the tokens of former versions of nets, and take out those at rest; after each turn."""
        for former in tuple(self._formers):
            successor = self._nets[former.written.former]
            if not hand_over(former, successor) and not former.at_rest():
                continue
            if former.at_rest():
                self._forget(former)
                self._node.get_logger().info(f"net {former.net.name} has ended its commands, and is gone")
                self._keep_sources()
            else:
                self._show(former)
            self._show(successor)
            with suppress(JournalError, NetError):  # the loop tries again, and says so; nothing leaves before
                if self._loop.journal is not None:
                    self._loop.journal.renew()
            self._loop.wake()

    def _forget(self, former: Executor) -> None:
        self._formers.remove(former)
        del self._nets[former.net.name]
        self._publisher.withdrawn(former.net.name)

    def _take_in(
        self,
        net: Net,
        report: Verification,
        state: dict[str, object] | None = None,
        enter: Callable[[Executor], None] | None = None,
    ) -> None:
        check_net(net, RosTypes())
        self._functions.check(net)
        accept(report)
        if report.unproved:
            self._observer.unproved(report.sentence)
        else:
            self._node.get_logger().info(report.sentence)
        wakes = self._functions.wakes(net)
        self._sources.check_topics(net.name, wakes)
        require_one_type(net, [each for each in self._written() if each.name != net.name])
        self._runner.prepare(net)
        executor = self._make(net)
        if state is not None:
            restore_net(executor, state)
        elif net.name in self._nets:
            count_on(self._nets[net.name], executor)
        (enter or self._exchange.add)(executor)
        if net.former:
            self._formers.append(executor)
        self._sources.declare(wakes)
        self._show(executor)
        self._loop.wake()

    def _show(self, executor: Executor) -> None:
        self._mission.loaded(executor)
        self._publisher.described(executor)
        self._publisher.marked(executor)

    def _written(self) -> list[Net]:
        return [executor.written for executor in self._nets.values()]

    def _prepare_partners(self) -> None:
        """Prepare the ways to the nets of other nodes, for all partners of the nets of the node."""
        for partner in {name for net in self._written() for name in net.partners()} - self._nets.keys():
            self._transport.prepare(partner)

    def _keep_sources(self) -> None:
        """Stop following the objects needed only by guards of removed nets."""
        self._sources.keep({source for net in self._written() for source in self._functions.wakes(net)})

    async def verified(self, net: Net, beside: Sequence[Net] = (), without: str = "") -> Verification:
        """Verify a net, alone and with the partners.

        Args:
            net: The net.
            beside: Nets that take the places of those of their names.
            without: Net of this node that will have gone.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: They do not fit together.
        """
        await self._library.read()
        own = {name: each.written for name, each in self._nets.items() if name != without and not each.written.former}
        own |= {each.name: each for each in beside}
        together = [each for each in self._library.group(net, list(own.values())) if each.name != without]
        alone = await self.verified_alone(net)
        if len(together) == 1:
            return alone
        composed = await self._accepted(net, together)
        return alone if alone.unproved else composed

    async def verified_alone(self, net: Net) -> Verification:
        """Verify a net alone: faults of the net show with the shortest sequence, and soon.

        Raises:
            VerificationError: The net may not run; carries the firing sequence that shows why.
            NetError: It does not fit together.
        """
        return await self._accepted(net, [net])

    async def _accepted(self, net: Net, nets: Sequence[Net]) -> Verification:
        report = await run_in_thread(self._node, self._library.verify, nets)
        try:
            accept(report)
        except VerificationError as error:
            self._publisher.refused(net.name, error.message, report.composed, report.refusals)
            raise
        return report

    async def _until_rest(self, executor: Executor, patience_s: float, successor: Net | None = None) -> None:
        """Wait until a net is at rest, or may go on as a former version of a successor."""
        began = monotonic()
        while rest := self._former_of(executor) or "; ".join(executor.at_rest().reasons):
            why = "" if successor is None else self._hindrance(executor, successor)
            if successor is not None and not why and not executor.due:
                return
            if monotonic() - began > (max(patience_s, TURN_S) if executor.due else patience_s):
                name = executor.net.name
                while_busy = f"; its commands cannot go on in a former version: {why}" if why not in ("", rest) else ""
                raise StateError(f"net {name} is not at rest and stays as it is: {rest}{while_busy}", net=name)
            await pause(self._node, REST_CHECK_S)


def carried_over(executor: Executor, net: Net) -> Net:
    """Return a net with the tokens of the resting predecessor; unchanged where no token of the predecessor has moved.

    Raises:
        NetError: A place that is marked is not in the new net.
    """
    marking = executor.marking()
    if marking == executor.net.initial_marking():
        return net
    structure = executor.net.places.keys() - executor.written.places.keys()
    missing = [f"{place}={count}" for place, count in marking.items() if place not in {*net.places, *structure}]
    if missing:
        raise NetError(
            f"net {net.name} cannot take the place of the present one, which holds {', '.join(missing)}: "
            "it has no such place",
            net=net.name,
        )
    places = {
        name: replace(place, tokens=marking.get(name, 0)) if name in executor.net.places else place
        for name, place in net.places.items()
    }
    return replace(net, places=places)
