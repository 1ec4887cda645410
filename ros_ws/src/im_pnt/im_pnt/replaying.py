"""Entries of a journal done again: the same marking, jobs and numbers, and nothing begun or told."""

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.events import Observer
from im_pnt.firing import FiringRule
from im_pnt.handling import take_request
from im_pnt.jobs import NO_LINEAGE, Activity, ActivityState, Job, Reply
from im_pnt.modes import Mode, Operator
from im_pnt.record import Entry, decode_command, decode_request, take_data
from im_pnt.remote import decode_error


def replay(rule: FiringRule, operator: Operator, entry: Entry) -> None:
    """Does again what an entry tells; see :mod:`im_pnt.record`.

    Raises:
        NetError: It does not fit the net, or what has happened to it.
    """
    record, observer = rule.record, rule.teller.observer
    rule.record, rule.teller.observer = None, Observer()
    try:
        _replay(rule, operator, entry)
    except (LookupError, TypeError, ValueError, AssertionError) as error:
        text = f"net {rule.net.name} cannot do again what a journal tells, {str(entry)[:200]}: {error}"
        raise NetError(text, net=rule.net.name) from error
    finally:
        rule.record, rule.teller.observer = record, observer


def _replay(rule: FiringRule, operator: Operator, entry: Entry) -> None:
    match entry:
        case ["command", *command]:
            rule.write(_command(rule, command))
        case ["request", request]:
            take_request(rule, decode_request(request))
        case ["token", str(place), int(count)]:
            rule.put(place, count, NO_LINEAGE)
        case ["cancel", number, error] if number is None or isinstance(number, int):
            rule.cancel(rule.ledger.of_command(number), _error(error))
        case ["request_cancelled", str(request), error]:
            rule.cancel(rule.ledger.of_request(request), _error(error))
        case ["ended", int(number), error, dict(results)]:
            if number in rule.activities:
                rule.activities[number].reply = Reply(decode_error(error), results)
        case ["mode", str(mode)]:
            operator.set_mode(Mode(mode))
        case ["pause", bool(paused)]:
            operator.pause(paused)
        case ["fire", str(name)]:
            _fire(rule, name)
        case ["phase", int(number), str(name), error]:
            doubtful = name.endswith((".lost", ".lost.cancelling"))
            activity = _activity(rule, number, name)
            activity.cancelled = True
            rule.move(activity, ActivityState.IN_DOUBT if doubtful else ActivityState.CANCELLING, _error(error))
        case ["end", int(number), str(name), error, data]:
            activity = _activity(rule, number, name)
            if data is not None and activity.lineage.job is not None:
                take_data(activity.lineage.job, data)
            results = activity.reply.results if activity.reply is not None else {}
            rule.apply_end(activity, name, decode_error(error), results)
        case ["guard", int(number), error]:
            _job(rule, number).last_failure = _error(error)
        case ["forgotten", int(number), error]:
            rule.close(_job(rule, number), _error(error))
        case _:
            raise ValueError("it is no entry of a net")


def _command(rule: FiringRule, content: object) -> Job:
    command = decode_command(content)
    if command.symbol not in rule.readers:
        raise ValueError(f"the net does not know the command {command.symbol}")
    return Job(command, command.arguments)


def _fire(rule: FiringRule, name: str) -> None:
    index = rule.number[name]
    symbol = rule.transitions[index].symbol
    if rule.enabling.unmet[index] or (symbol is not None and not rule.ledger.tape.has(symbol)):
        raise ValueError(f"{name} is not enabled")
    rule.fire(index)


def _activity(rule: FiringRule, number: int, name: str) -> Activity:
    activity = rule.activities[number]
    if rule.enabling.unmet[rule.number[name]] or rule.transitions[rule.number[name]].origin != activity.transition:
        raise ValueError(f"{name} is not enabled")
    return activity


def _job(rule: FiringRule, number: int) -> Job:
    job = rule.ledger.job(number)
    if job is None:
        raise ValueError(f"no job of number {number} is open")
    return job


def _error(content: object) -> ImError:
    error = decode_error(content)
    if error is None:
        raise ValueError("it says no reason")
    return error
