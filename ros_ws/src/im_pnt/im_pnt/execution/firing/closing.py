"""Closing of jobs as a net comes to rest: no client waits in vain."""

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.firing.entries import happens
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.jobs import Job
from im_pnt.execution.journal_entries import JobForgotten, VisitSettled


def settle_visits(rule: FiringRule) -> None:
    """Release the jobs of other nets without tokens here."""
    left = {lineage.job for queue in rule.tokens.queues.values() for lineage in queue}
    left |= {activity.lineage.job for activity in rule.activities.values()}
    for job in list(rule.ledger.visits.values()):
        if job not in left and not job.away:
            happens(rule, VisitSettled(job.number))


def expire(rule: FiringRule, job: Job) -> None:
    """End a symbol on the tape after the time."""
    if job.waiting:
        seconds = rule.expires[job.symbol]
        limit = f"within {seconds:g} s" if seconds else "before the net came to rest"
        text = f"nothing has asked for {job.symbol} {limit}"
        happens(rule, JobForgotten(job.number, NetError(text, net=rule.net.name, symbol=job.symbol)))


def drop_stale(rule: FiringRule) -> None:
    """End the symbols without a waiting transition as the net comes to rest, unless allowed to wait."""
    for symbol, seconds in rule.expires.items():
        asked = any(not rule.enabling.unmet[index] and rule.owners(index) for index in rule.readers[symbol])
        if seconds == 0.0 and not asked:
            for job in list(rule.ledger.tape.of_symbol(symbol)):
                expire(rule, job)


def close_forgotten(rule: FiringRule) -> None:
    """End the commands no longer acknowledgeable by a resting net, so no client waits in vain."""
    if not len(rule.ledger) or rule.activities or rule.enabling.clocks:
        return
    begun = rule.ledger.begun_commands()
    if not begun or any(place not in rule.net.rest_places() for place in rule.tokens.marking()):
        return
    for job in begun:
        if job.away:
            continue
        text = f"net {rule.net.name} came to rest and emitted neither {job.symbol}_done nor {job.symbol}_failed"
        error = job.last_failure or ImError(text, code="net", symbol=job.symbol)
        happens(rule, JobForgotten(job.number, error))
