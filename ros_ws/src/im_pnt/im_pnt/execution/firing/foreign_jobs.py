"""Jobs with tokens in several nets.

Who sends a token is told when its work is done, there and wherever it has led to: so a net knows where its jobs are,
and what is said of them follows their tokens (E.W. Dijkstra and C.S. Scholten, "Termination detection for diffusing
computations", 1980). Cancels and pauses are believed of who has sent the first token, so that each comes once and in
order.
"""

from collections.abc import Iterable

from im_core.errors import ImError
from im_pnt.execution.events import JobUpdate, JobUpdateArrived, TokenArrived
from im_pnt.execution.firing.rule import FiringRule
from im_pnt.execution.jobs import NO_LINEAGE, Job, Lineage, TokenContext, Visit
from im_pnt.execution.journal_entries import add_results


def take_token(rule: FiringRule, event: TokenArrived) -> None:
    """Take a token of a job from another net."""
    context = event.context
    assert context is not None
    owner, home = context.owner, context.home
    job, place = rule.ledger.of_key(owner.key, home), rule.place[event.place]
    known, stays = job is not None, rule.tokens.carries(place)
    if job is None and stays and not home:
        job = Job(owner.command, owner.arguments, visit=Visit(owner, context.node, context.net))
        rule.ledger.add(job)
    if job is not None:
        add_results(job, context.results, rule.keeps)
        job.last_failure = context.failure or job.last_failure
    if job is not None and not home:
        if context.held:
            rule.hold(-job.number, True, [job])
        if context.cancelled is not None and not job.cancelled:
            rule.cancel([job], context.cancelled)
    rule.tokens.put_tokens(place, event.count, NO_LINEAGE if job is None else Lineage(job, None))
    if known or job is None:
        rule.outlet.send_settled(rule.net.name, owner.key, context.node, context.net, None, {})


def hear(rule: FiringRule, event: JobUpdateArrived) -> None:
    """Take an update of a job from another net."""
    job = rule.ledger.of_key(event.key, event.home)
    if job is None:  # it has ended meanwhile
        return
    match event.update:
        case JobUpdate.SETTLED:
            add_results(job, event.results, rule.keeps)
            job.last_failure = event.error or job.last_failure
            left = job.away.get(event.net, 0) - 1
            if left > 0:
                job.away[event.net] = left
            else:
                job.away.pop(event.net, None)
        case JobUpdate.CANCELLED if _is_from_parent(job, event.net):
            rule.cancel([job], event.error or cancelled_elsewhere(event.net))
        case JobUpdate.HELD | JobUpdate.RELEASED if _is_from_parent(job, event.net):
            rule.hold(-job.number, event.update is JobUpdate.HELD, [job])
        case JobUpdate.ENDED:
            rule.close(job, None)
        case JobUpdate.CONCLUDED if event.home and job.from_tape:
            add_results(job, event.results, rule.keeps)
            rule.close(job, event.error)


def cancelled_visit(rule: FiringRule, event: object) -> tuple[Job, ImError] | None:
    """Return the foreign job an event will cancel with the actions, and the reason; None without one."""
    match event:
        case TokenArrived(context=TokenContext(owner=owner, home=False, cancelled=ImError() as error)):
            job = rule.ledger.visits.get(owner.key)
            return None if job is None or job.cancelled else (job, error)
        case JobUpdateArrived(key=key, update=JobUpdate.CANCELLED, net=net, error=why):
            job = rule.ledger.visits.get(key)
            if job is not None and _is_from_parent(job, net):
                return job, why or cancelled_elsewhere(net)
    return None


def forget_node(rule: FiringRule, node: str, nets: Iterable[str], error: ImError) -> None:
    """Give up tokens sent to a node, and end the jobs from the node."""
    for job in rule.ledger.jobs():
        for net in job.away.keys() & set(nets):
            del job.away[net]
            job.last_failure = error
            rule.outlet.send_job_update(rule.net.name, job, JobUpdate.ENDED, net, error, {})
        if job.visit is not None and job.visit.node == node:
            rule.cancel([job], error)
            leave(rule, job)


def leave(rule: FiringRule, job: Job) -> None:
    """End a foreign job, and tell the sender of the first token."""
    visit = job.visit
    assert visit is not None
    results = rule.news(job, visit.net)
    rule.close(job, None)
    rule.outlet.send_settled(rule.net.name, visit.owner.key, visit.node, visit.net, job.last_failure, results)


def _is_from_parent(job: Job, net: str) -> bool:
    return job.visit is not None and job.visit.net == net


def cancelled_elsewhere(net: str) -> ImError:
    """Return the reason of a job's early end by a cancellation in the net of the tokens."""
    return ImError(f"cancelled by net {net}", code="cancelled", net=net)
