"""What the events of a net do to it."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.events import (
    ActionEnded,
    Answered,
    CommandCancelled,
    CommandWritten,
    Confirmed,
    Event,
    GuardsChanged,
    ModeSet,
    ObjectInvalidated,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    StepAsked,
    TokenArrived,
)
from im_pnt.expand import input_place
from im_pnt.firing import FiringRule
from im_pnt.jobs import NO_LINEAGE, Activity, Job, Lineage, Reply, Request
from im_pnt.record import Entry, encode_command, encode_request, plain_dict
from im_pnt.remote import encode_error

if TYPE_CHECKING:
    from im_pnt.operation import Operation


def handle(operation: "Operation", event: Event) -> None:
    """Takes an event; it is recorded before anything is done."""
    rule = operation.rule
    match event:
        case TokenArrived(place, count):
            if rule.record is not None:
                rule.record(["token", place, count])
            rule.put(place, count, NO_LINEAGE)
        case CommandWritten(job):
            _record(rule, lambda: ["command", *encode_command(job.command)])
            rule.write(job)
        case CommandCancelled(command_id, error):
            _record(rule, lambda: ["cancel", command_id, encode_error(error)])
            _cancel(operation, rule.ledger.of_command(command_id), error, everything=command_id is None)
        case RequestArrived(request):
            _record(rule, lambda: ["request", encode_request(request)])
            take_request(rule, request)
        case RequestCancelled(request_id, error):
            _record(rule, lambda: ["request_cancelled", request_id, encode_error(error)])
            _cancel(operation, rule.ledger.of_request(request_id), error)
        case ActionEnded(activity, failure, results):
            _ended(operation, activity, failure, results)
        case Answered(activity, answer):
            operation.actions.inquiry.take(activity, answer)
        case ObjectInvalidated(name):
            rule.withdraw(name)
            operation.chooser.wake(f"data:{name}")
        case GuardsChanged(source):
            operation.chooser.wake(source)
        case ModeSet(mode):
            _record(rule, lambda: ["mode", mode.value])
            operation.operator.set_mode(mode)
            operation.release()
        case PauseSet(paused):
            _record(rule, lambda: ["pause", paused])
            operation.operator.pause(paused)
            operation.release()
        case StepAsked():
            operation.operator.step()
            operation.release()
        case Confirmed(transition):
            operation.confirm(transition)


def take_request(rule: FiringRule, request: Request) -> None:
    """Takes a request: to the place I of its service, or, where it names a symbol, to the input tape."""
    job = Job(request.command, request.arguments, request)
    if request.service in rule.net.services:
        rule.ledger.add(job)
        rule.put(input_place(request.service), 1, Lineage(job, None))
    elif request.service in rule.readers:
        rule.write(job)
    else:
        rule.ledger.add(job)
        text = f"net {rule.net.name} offers no service and reads no symbol {request.service}"
        rule.close(job, NetError(text, net=rule.net.name, service=request.service))


def _cancel(operation: "Operation", jobs: list[Job], error: ImError, *, everything: bool = False) -> None:
    operation.rule.cancel(jobs, error)
    wanted = {job.number for job in jobs}
    for activity in list(operation.rule.activities.values()):
        job = activity.lineage.job
        if everything or (job is not None and job.number in wanted):
            operation.actions.cancel(activity, error)
    for job in jobs:
        operation.chooser.wake_job(job)


def _ended(
    operation: "Operation", activity: Activity, error: ImError | None, results: dict[str, object]
) -> None:
    rule = operation.rule
    if rule.record is not None:
        try:
            results = plain_dict(results, f"the results of {activity.action}")
        except NetError as unfit:
            error, results = error or unfit, {}
        rule.record(["ended", activity.number, encode_error(error), results])
    if rule.activities.get(activity.number) is not activity:
        outcome = f"failed ({error})" if error else "confirmed"
        text = f"{activity.action} of transition {activity.transition} {outcome} after it had been given up"
        rule.teller.troubled(text)
        return
    activity.reply = Reply(error, results)
    operation.actions.finish(activity, error, results)


def _record(rule: FiringRule, entry: Callable[[], Entry]) -> None:
    if rule.record is not None:
        rule.record(entry())
