"""Entries of a net: applied now, and again, in the same order, in a replay of the journal."""

from im_pnt.execution.events import (
    BreakpointSet,
    CommandCancelled,
    CommandHeld,
    CommandWritten,
    JobUpdateArrived,
    ModeSet,
    NodeForgotten,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.firing.foreign_jobs import forget_node, hear, leave, take_token
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.jobs import NO_LINEAGE, Activity, ActivityState, Job, Reply
from im_pnt.execution.journal_entries import (
    ActivityEnded,
    EndFired,
    GuardBroke,
    JobForgotten,
    MessageBuilt,
    NetEntry,
    PhaseFired,
    TransitionFired,
    VisitSettled,
    take_data,
)


def happens(rule: FiringRule, entry: NetEntry) -> None:
    """Record and apply an entry."""
    if rule.record is not None:
        rule.record(entry)
    apply_entry(rule, entry)


def apply_entry(rule: FiringRule, entry: NetEntry) -> None:
    """Apply an entry.

    Raises:
        ValueError: It does not fit the net, or what has happened to it.
        LookupError: Likewise.
    """
    match entry:
        case TransitionFired(name, number):
            _fire_again(rule, name, number)
        case TokenArrived(place, count, None):
            rule.mark_place(place, count, NO_LINEAGE)
        case TokenArrived():
            take_token(rule, entry)
        case JobUpdateArrived():
            hear(rule, entry)
        case NodeForgotten(node, nets, error):
            forget_node(rule, node, nets, error)
        case VisitSettled(number):
            leave(rule, _open_job(rule, number))
        case EndFired(number, name, error, data):
            activity = _running(rule, number, name)
            if data is not None and activity.lineage.job is not None:
                take_data(activity.lineage.job, data)
            rule.end(activity, name, error, activity.reply.results if activity.reply is not None else {})
        case MessageBuilt(number, data):
            if (job := rule.activities[number].lineage.job) is None:
                raise ValueError(f"activity {number} belongs to no job")
            take_data(job, data)
        case PhaseFired(number, name, error):
            activity = _running(rule, number, name)
            activity.cancelled = True
            doubtful = name.endswith((".lost", ".lost.cancelling"))
            rule.move(activity, ActivityState.IN_DOUBT if doubtful else ActivityState.CANCELLING, error)
        case ActivityEnded(number, failure, results, data):
            if (ended := rule.activities.get(number)) is not None:
                if data is not None and ended.lineage.job is not None:
                    take_data(ended.lineage.job, data)
                ended.reply = Reply(failure, results)
        case CommandWritten(job):
            if job.symbol not in rule.readers:
                raise ValueError(f"the net does not know the command {job.symbol}")
            rule.write(job)
        case RequestArrived(request, held):
            rule.take_request(request)
            if held:
                _hold_request(rule, request.id, True)
        case CommandCancelled(command_id, error):
            rule.cancel(rule.ledger.of_command(command_id), error)
        case RequestCancelled(request_id, error):
            rule.cancel(rule.ledger.of_request(request_id), error)
        case CommandHeld(None, held):
            for job in rule.ledger.jobs():
                if job.command.id != 0:  # what is done for nobody could be resumed by nobody
                    rule.hold(rule.hold_number(job), held, [job], job.command.scope if job.is_command else "")
            if not held:
                rule.held.clear()
        case CommandHeld(int(command_id), held, scope):
            rule.hold(command_id, held, rule.ledger.of_command(command_id), scope)
        case RequestHeld(request_id, held):
            _hold_request(rule, request_id, held)
        case GuardBroke(number, error):
            _open_job(rule, number).last_failure = error
        case JobForgotten(number, error):
            job = _open_job(rule, number)
            rule.ledger.tape.withdraw(job)
            rule.close(job, error)
        case ModeSet() | PauseSet() | BreakpointSet():
            raise ValueError("mode, pause and breakpoints are set by the operator, not by a rule")


def _hold_request(rule: FiringRule, request_id: str, held: bool) -> None:
    for job in rule.ledger.of_request(request_id):
        rule.hold(-job.number, held, [job])


def _fire_again(rule: FiringRule, name: str, number: int | None) -> None:
    index = rule.number[name]
    symbol = rule.transitions[index].symbol
    if not rule.enabling.allows(index) or (symbol is not None and not rule.ledger.tape.has(symbol)):
        raise ValueError(f"{name} is not enabled")
    owners = rule.owners(index)
    if number is None:
        rule.fire(index, owners[0])
        return
    if number not in [owner.number if owner is not None else 0 for owner in owners]:
        raise ValueError(f"{name} is not enabled for job {number}")
    rule.fire(index, rule.ledger.job(number))


def _running(rule: FiringRule, number: int, name: str) -> Activity:
    activity, index = rule.activities[number], rule.number[name]
    if not rule.enabling.allows(index) or rule.transitions[index].origin != activity.transition:
        raise ValueError(f"{name} is not enabled")
    return activity


def _open_job(rule: FiringRule, number: int) -> Job:
    job = rule.ledger.job(number)
    if job is None:
        raise ValueError(f"no job of number {number} is open")
    return job
