"""Abandonment: the last resort for a command that nothing ends, with the report of what it held."""

from collections.abc import Iterable

from im_core.errors import ImError
from im_pnt.execution.executor import Executor
from im_pnt.execution.firing.rule import ABANDONED_CODE, FiringRule
from im_pnt.execution.jobs import ActivityState, Command, Job


def abandonment(nets: Iterable[Executor], command: Command, why: str) -> ImError:
    """Return the error that ends a command at once, in a net and wherever its tokens and requests have led to.

    Returns:
        The error; the facts ``held``, ``actions``, ``doubts`` and ``freed`` tell the places with data objects, the
        actions under way, those in doubt, and the tokens that come back to the nets.
    """
    held: list[str] = []
    actions: list[str] = []
    doubts: list[str] = []
    freed: list[str] = []
    for rule in (executor.rule for executor in nets):
        for job in rule.ledger.jobs():
            if job.command == command:
                held += _held(rule, job)
                for each in rule.actions_of(job):
                    told = f"{each.action} of {rule.net.name}.{each.transition}"
                    if each.state is ActivityState.IN_DOUBT:
                        doubts.append(f"{told} ({each.doubt})")
                    else:
                        actions.append(told)
                freed += [f"{rule.net.name}.{place}" for place in rule.freed_by(job)]
    parts = {
        "it held": held,
        "under way, cancelled and not awaited": actions,
        "in doubt, and left so": doubts,
        "given back": freed,
    }
    told = "; ".join([why, *(f"{what}: {', '.join(each)}" for what, each in parts.items() if each)])
    return ImError(told, code=ABANDONED_CODE, held=held, actions=actions, doubts=doubts, freed=freed)


def _held(rule: FiringRule, job: Job) -> list[str]:
    net = rule.net.name
    if job.waiting:
        return [f"symbol {job.symbol} on the tape of {net}"]
    told = []
    for number, queue in rule.tokens.queues.items():
        if count := sum(lineage.job is job for lineage in queue):
            place = rule.net.places[rule.tokens.compiled.places[number]]
            name = rule.object_name(place.data_object, job) if place.data_object else ""
            told.append(f"{net}.{place.name}{f' x {count}' if count > 1 else ''}{f' ({name})' if name else ''}")
    return told + [f"tokens in net {other}" for other in job.away]
