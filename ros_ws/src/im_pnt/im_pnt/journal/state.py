"""The state of a net in execution as JSON data, taken and brought back."""

import json
from collections.abc import Mapping

from im_pnt.errors import NetError
from im_pnt.firing import FiringRule
from im_pnt.jobs import NO_LINEAGE, Activity, ActivityState, Job, Lineage, Reply
from im_pnt.modes import Mode, Operator
from im_pnt.record import data_of, decode_command, decode_request, encode_command, encode_request, plain, take_data
from im_pnt.remote import decode_error, encode_error


def snapshot(rule: FiringRule, operator: Operator) -> dict[str, object]:
    """Returns the state of a net as JSON data.

    Raises:
        NetError: A job holds something that JSON cannot carry.
    """
    jobs = {job.number: job for job in rule.ledger.jobs()}
    for activity in rule.activities.values():
        if activity.lineage.job is not None:
            jobs.setdefault(activity.lineage.job.number, activity.lineage.job)
    places: dict[str, object] = {}
    for name, tokens in rule.tokens.marking().items():
        queue = rule.tokens.queues.get(rule.place[name])
        lineages = [_lineage(rule, lineage) for lineage in queue or ()]
        places[name] = lineages if any(lineages) else tokens
    serving = rule.ledger.serving
    return {
        "sequence": rule.teller.sequence,
        "places": places,
        "entered": rule.ledger.count,
        "jobs": [_job(rule, job) for job in jobs.values()],
        "tape": [job.number for job in rule.ledger.tape.waiting()],
        "serving": serving.number if serving is not None else None,
        "activities": [_activity(activity) for activity in rule.activities.values()],
        "mode": operator.mode.value,
        "paused": operator.paused,
    }


def restore(rule: FiringRule, operator: Operator, state: Mapping[str, object]) -> None:
    """Takes a state back.

    Raises:
        NetError: It is no state of this net.
    """
    try:
        _restore(rule, operator, state)
    except (LookupError, TypeError, ValueError, AssertionError) as error:
        raise NetError(f"this is no state of net {rule.net.name}: {error!r}", net=rule.net.name) from error


def _restore(rule: FiringRule, operator: Operator, state: Mapping[str, object]) -> None:
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
        rule.enabling.take(rule.place[name], tokens)
    for name, content in places.items():
        lineages = [None] * content if isinstance(content, int) else content
        for entry in lineages:
            rule.put(name, 1, _lineage_of(known, entry))
    for content in running:
        activity = _activity_of(rule, known, content)
        rule.activities[activity.number] = activity
    rule.ledger.count = entered
    rule.ledger.serving = known[serving] if serving is not None else None
    rule.teller.sequence = sequence
    operator.set_mode(Mode(mode))
    operator.pause(paused)


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
    asked = encode_command(job.command) if job.request is None else encode_request(job.request)
    data = data_of(job) if rule.record is None else json.loads(job.recorded)
    replies = plain(job.replies, "the replies")
    flags = [rule.ledger.is_open(job), job.request is not None, job.from_tape, job.cancelled, job.unwanted]
    return [job.number, flags, asked, data, replies, encode_error(job.last_failure)]


def _job_of(content: object) -> tuple[Job, bool]:
    match content:
        case [int(number), list(flags), asked, data, dict(replies), error]:
            is_open, requested, from_tape, cancelled, unwanted = (flag is True for flag in flags)
            request = decode_request(asked) if requested else None
            command = request.command if request is not None else decode_command(asked)
            arguments = request.arguments if request is not None else command.arguments
            job = Job(command, arguments, request, number=number, from_tape=from_tape, cancelled=cancelled)
            job.replies.update(replies)
            job.last_failure = decode_error(error)
            job.closed, job.unwanted = not is_open, unwanted
            take_data(job, data)
            return job, is_open
    raise ValueError(f"{str(content)[:80]} is no job")


def _activity(activity: Activity) -> list[object]:
    lineage = activity.lineage
    reply = None
    if activity.reply is not None:
        reply = [encode_error(activity.reply.error), plain(activity.reply.results, "a reply")]
    return [
        activity.number,
        activity.transition,
        activity.state.value,
        lineage.job.number if lineage.job is not None else None,
        encode_error(lineage.failure),
        encode_error(activity.doubt),
        reply,
    ]


def _activity_of(rule: FiringRule, known: Mapping[object, Job], content: object) -> Activity:
    match content:
        case [int(number), str(transition), str(state), job, failure, doubt, None | list() as reply]:
            lineage = _lineage_of(known, [job, failure])
            activity = rule.new_activity(rule.number[f"{transition}.start"], number, lineage)
            activity.state = ActivityState(state)
            activity.cancelled = activity.state is not ActivityState.ACTIVE
            activity.doubt, activity.doubted = decode_error(doubt), activity.began
            if reply is not None:
                activity.reply = Reply(decode_error(reply[0]), dict(reply[1]))
            return activity
    raise ValueError(f"{str(content)[:80]} is no action that runs")
