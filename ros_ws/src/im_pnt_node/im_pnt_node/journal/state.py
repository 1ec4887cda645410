"""The state of nets in execution, of an exchange and of a link as JSON data: taken, and brought back."""

import json
from collections.abc import Mapping

from im_core.errors import StateError
from im_pnt.errors import NetError, decode_error, encode_error
from im_pnt.execution.events import BreakpointSet
from im_pnt.execution.executor import Executor
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.jobs import NO_LINEAGE, Activity, ActivityState, Job, JobData, Lineage
from im_pnt.execution.journal_entries import data_of, plain, recorded_data, take_data
from im_pnt.execution.operator import Mode
from im_pnt.model.net import Net, RemotePlace
from im_pnt_node.distributed.codec import COMMAND, DELIVERY, REPLY, REQUEST, VISIT
from im_pnt_node.distributed.entries import RequestAsked
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.distributed.link import Link
from im_pnt_node.distributed.packets import decode_message, is_epoch, is_number, numbered
from im_pnt_node.distributed.streams import Peer, Sent

# Nets.


def net_state(executor: Executor) -> dict[str, object]:
    """Return the state of a net; call between two calls of ``pump``.

    Raises:
        NetError: A job holds something that JSON cannot carry.
    """
    rule, operator = executor.rule, executor.operator
    jobs = {job.number: job for job in rule.ledger.jobs()}
    for activity in rule.activities.values():
        if activity.lineage.job is not None:
            jobs.setdefault(activity.lineage.job.number, activity.lineage.job)
    places: dict[str, object] = {}
    for name, tokens in rule.tokens.marking().items():
        queue = rule.tokens.queues.get(rule.place[name])
        lineages = [_lineage(rule, lineage) for lineage in queue or ()]
        places[name] = lineages if any(lineages) else tokens
    serving = list(rule.ledger.serving)
    return {
        "sequence": rule.notifier.sequence,
        "places": places,
        "entered": rule.ledger.count,
        "jobs": [_job(rule, job) for job in jobs.values()],
        "tape": [job.number for job in rule.ledger.tape.waiting()],
        "serving": serving if len(serving) > 1 else next(iter(serving), None),
        "activities": [_activity(activity) for activity in rule.activities.values()],
        **({"held": [[number, scope] for number, scope in sorted(rule.held.items())]} if rule.held else {}),
        "mode": operator.mode.value,
        "paused": operator.paused,
        **({"breakpoints": list(executor.breakpoints)} if operator.breakpoints else {}),
    }


def restore_net(executor: Executor, state: Mapping[str, object]) -> None:
    """Restore a state, before any event.

    Raises:
        NetError: It is no state of this net.
    """
    try:
        _restore(executor, state)
    except (NetError, LookupError, TypeError, ValueError, AssertionError) as error:
        raise NetError(f"this is no state of net {executor.net.name}: {error!r}", net=executor.net.name) from error


def _restore(executor: Executor, state: Mapping[str, object]) -> None:
    rule, operator = executor.rule, executor.operator
    match state:
        case {
            "sequence": int(sequence),
            "places": dict(places),
            "entered": int(entered),
            "jobs": list(jobs),
            "tape": list(tape),
            "serving": serving,
            "activities": list(running),
            "mode": str(mode),
            "paused": bool(paused),
        }:
            pass
        case _:
            raise ValueError(str(state)[:200])
    known: dict[object, Job] = {}
    for content in jobs:
        job, is_open = _job_of(content)
        known[job.number] = job
        if is_open:
            rule.ledger.reopen(job)
    for number in tape:
        rule.ledger.tape.write(known[number])
    for name, tokens in rule.tokens.marking().items():
        rule.enabling.take_tokens(rule.place[name], tokens)
    for name, content in places.items():
        lineages = [None] * content if isinstance(content, int) else content
        for entry in lineages:
            rule.mark_place(name, 1, _lineage_of(known, entry))
    for content in running:
        activity = _activity_of(rule, known, content)
        rule.activities[activity.number] = activity
    held = state.get("held", [])
    assert isinstance(held, list)
    rule.held = dict(_held_of(entry) for entry in held)
    rule.ledger.count = entered
    served = serving if isinstance(serving, list) else [] if serving is None else [serving]
    rule.ledger.serving = {job.number: job for job in (known[number] for number in served)}
    rule.notifier.sequence = sequence
    operator.set_mode(Mode(mode))
    operator.pause(paused)
    breakpoints = state.get("breakpoints", [])
    assert isinstance(breakpoints, list)
    for name in breakpoints:
        if name in executor.written.transitions:  # the net may be the successor of another one
            executor.replay(BreakpointSet(name, True))


def _held_of(content: object) -> tuple[int, str]:
    match content:
        case [int(number), str(scope)]:
            return number, scope
    raise ValueError(f"{str(content)[:80]} is no command that is held")


def _lineage(rule: FiringRule, lineage: Lineage) -> object:
    job = lineage.job if lineage.job is not None and rule.ledger.is_open(lineage.job) else None
    if job is None and lineage.failure is None:
        return None
    return [job.number if job is not None else None, encode_error(lineage.failure)]


def _lineage_of(known: Mapping[object, Job], content: object) -> Lineage:
    match content:
        case None:
            return NO_LINEAGE
        case [number, error]:
            return Lineage(known[number] if number is not None else None, decode_error(error))
    raise ValueError(f"{str(content)[:80]} is no lineage")


def _job(rule: FiringRule, job: Job) -> list[object]:
    asked = COMMAND.content(job.command) if job.request is None else REQUEST.content(job.request)
    crossed: dict[str, object] = {}
    if job.visit is not None:
        crossed["visit"] = VISIT.content(job.visit)
    if job.away:
        crossed["away"] = dict(job.away)
    if job.told:
        crossed["told"] = plain(job.told, "what other nets were told")
    data = data_of(job) if rule.record is None else recorded_data(job)
    replies = plain(job.replies, "the replies")
    flags = [rule.ledger.is_open(job), job.request is not None, job.from_tape, job.cancelled, job.unwanted]
    fields = [job.number, flags, asked, list(data), replies, encode_error(job.last_failure)]
    return [*fields, crossed] if crossed else fields


def _job_of(content: object) -> tuple[Job, bool]:
    match content:
        case [
            int(number), list(flags), asked, [dict(memory), dict(results), float(progress)], dict(replies), error, *rest
        ]:  # fmt: skip
            is_open, requested, from_tape, cancelled, unwanted = (flag is True for flag in flags)
            request = REQUEST.decode(asked) if requested else None
            command = request.command if request is not None else COMMAND.decode(asked)
            arguments = request.arguments if request is not None else command.arguments
            job = Job(command, arguments, request, number=number, from_tape=from_tape, cancelled=cancelled)
            for crossed in rest:
                _cross(job, crossed)
            job.replies.update(replies)
            job.last_failure = decode_error(error)
            job.closed, job.unwanted = not is_open, unwanted
            take_data(job, JobData(memory, results, progress))
            return job, is_open
    raise ValueError(f"{str(content)[:80]} is no job")


def _cross(job: Job, content: object) -> None:
    """Restore the record of a job's tokens between nets."""
    match content:
        case dict():
            pass
        case _:
            raise ValueError(f"{str(content)[:80]} does not tell what has crossed")
    match content.get("visit"):
        case None:
            pass
        case visit:
            job.visit = VISIT.decode(visit)
            job.arguments = job.visit.owner.arguments
    job.away = {str(net): int(count) for net, count in content.get("away", {}).items()}
    job.told = {str(net): dict(results) for net, results in content.get("told", {}).items()}


def _activity(activity: Activity) -> list[object]:
    lineage = activity.lineage
    reply = None
    if activity.reply is not None:
        reply = REPLY.content(activity.reply)
    return [
        activity.number,
        activity.transition,
        activity.state.value,
        lineage.job.number if lineage.job is not None else None,
        encode_error(lineage.failure),
        encode_error(activity.doubt),
        reply,
        *([activity.begun_as] if activity.begun_as else []),
    ]


def _activity_of(rule: FiringRule, known: Mapping[object, Job], content: object) -> Activity:
    match content:
        case [int(number), str(transition), str(state), job, failure, doubt, reply, *renamed]:
            lineage = _lineage_of(known, [job, failure])
            activity = rule.new_activity(transition, number, lineage)
            rule.set_state(activity, ActivityState(state))
            activity.cancelled = activity.state is not ActivityState.ACTIVE
            activity.doubt, activity.doubted = decode_error(doubt), activity.began
            if reply is not None:
                activity.reply = REPLY.decode(reply)
            if renamed:  # older journals have no net there
                activity.begun_as = str(renamed[0]) if "/" in str(renamed[0]) else f"{renamed[0]}/{activity.net}"
            return activity
    raise ValueError(f"{str(content)[:80]} is no action that runs")


def taken_over(executor: Executor, net: Net) -> dict[str, object]:
    """Return the state of a running net for the successor.

    Args:
        executor: The present net, all of whose events have been taken.
        net: The one that takes its place; places that the present one does not have are marked as it says.

    Raises:
        StateError: Something is under way that it does not have; names it.
    """
    marked = {place for place in executor.marking() if place in executor.written.places and place not in net.places}
    running = {each.transition for each in executor.activities if each.transition not in net.transitions}
    waiting = {job.symbol for job in executor.jobs() if job.waiting and job.symbol not in net.symbols()}
    missing = sorted(marked | running | waiting)
    if missing:
        text = f"net {net.name} cannot take the place of the present one now: {', '.join(missing)} is under way"
        raise StateError(text, net=net.name, missing=missing)
    state = net_state(executor)
    places = state["places"]
    assert isinstance(places, dict)
    added = {p.name: p.tokens for p in net.places.values() if p.tokens and p.name not in executor.written.places}
    return {**state, "places": {**places, **added}}


# The exchange.


def exchange_state(exchange: Exchange) -> dict[str, object]:
    """Return an exchange as JSON data."""
    book, inboxes = exchange.book, exchange.inboxes
    posted = {net: inboxes.not_late(net, events) for net, events in inboxes.deliveries.waiting().items()}
    return {
        "requests": [book.prefix, book.count, *([book.incarnation] if book.incarnation != book.prefix else [])],
        "asked": [[name, w.executor.net.name, w.activity.number, w.net, w.node] for name, w in book.items()],
        "in_work": [REQUEST.content(request) for request in inboxes.in_work.values()],
        "undeliverable": [[net, place, count] for (net, place), count in exchange.undeliverable.items()],
        "posted": {net: [DELIVERY.content(event) for event in events] for net, events in posted.items()},
    }


def restore_exchange(exchange: Exchange, state: Mapping[str, object]) -> None:
    """Restore an exchange with restored nets.

    Raises:
        ValueError: It is no state of an exchange.
        NetError: It speaks of activities that are not there.
        LookupError: It speaks of nets that are not there.
    """
    match state:
        case {
            "requests": [str(prefix), int(count), *renamed],
            "asked": list(asked),
            "in_work": list(in_work),
            "undeliverable": list(undeliverable),
            "posted": dict(posted),
        }:
            for fields in asked:
                match fields:
                    case [str(request_id), str(net), int(number), str(other), str(node)]:
                        exchange.watch(RequestAsked(request_id, net, number, other, node))
                    case _:
                        raise ValueError(f"{str(fields)[:200]} is no request")
            exchange.book.prefix, exchange.book.count = prefix, count
            exchange.book.incarnation = str(renamed[0]) if renamed else prefix
            for request in map(REQUEST.decode, in_work):
                exchange.inboxes.in_work[request.id] = request
            for net, events in posted.items():
                for event in events:
                    exchange.inboxes.deliveries.put_delivery(net, DELIVERY.decode(event))
            for net, place, tokens in undeliverable:
                exchange.undeliverable[RemotePlace(net, place)] = tokens
        case _:
            raise ValueError(f"{str(state)[:200]} is no state of an exchange")


# The link.


def link_state(link: Link) -> dict[str, object]:
    """Return a link as JSON data."""
    return {"epoch": link.epoch, "peers": {node: _peer(peer) for node, peer in link.peers.items()}}


def restore_link(link: Link, state: Mapping[str, object]) -> None:
    """Restore the streams of a link; all unacknowledged messages are sent again.

    Raises:
        ValueError: It is no state of a link.
    """
    match state:
        case {"epoch": int(epoch), "peers": dict(peers)}:
            link.epoch = epoch
            link.peers = {str(node): _peer_of(node, peer) for node, peer in peers.items()}
        case _:
            raise ValueError(f"{str(state)[:200]} is no state of a link")


def _peer(peer: Peer) -> dict[str, object]:
    incoming, outgoing = peer.incoming, peer.outgoing
    refused = [[number, reason] for number, reason in incoming.refused.items()]
    waiting = [json.loads(sent.text) for sent in outgoing.waiting.values()]
    heard = [incoming.epoch, incoming.floor, refused]
    parted = {"parted": True} if incoming.parted else {}
    return {"heard": heard, "last": outgoing.last, "waiting": waiting, "journal": peer.keeps_journal, **parted}


def _peer_of(name: str, state: Mapping[str, object]) -> Peer:
    match state:
        case {"heard": [int(epoch), int(floor), list(refused)], "last": int(last), "waiting": list(waiting)}:
            peer = Peer(name)
            peer.incoming.epoch, peer.incoming.floor = epoch, floor
            peer.incoming.ack_at = 0.0 if floor else None
            peer.incoming.refused = {int(number): str(reason) for number, reason in refused}
            peer.outgoing.last = last
            peer.keeps_journal, peer.incoming.parted = state.get("journal") is True, state.get("parted") is True
            for number, *fields in waiting:
                peer.outgoing.waiting[number] = Sent(numbered(number, decode_message(fields)))
            peer.outgoing.floor = next(iter(peer.outgoing.waiting), last + 1) - 1
            if is_number(last) and is_epoch(epoch) and is_number(floor):
                return peer
    raise ValueError(f"{str(state)[:200]} is no state of a stream")
