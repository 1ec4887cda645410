"""Succession of a busy net: the former version ends its commands, and the tokens at rest go over to the new one."""

from dataclasses import replace

from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import NO_LINEAGE
from im_pnt.execution.journal_entries import Record
from im_pnt.model.expand import expand
from im_pnt.model.net import Net
from im_pnt.model.resources import given_back


def hindrance_of_succession(executor: Executor, net: Net) -> str:
    """Return the reason against the succession of a busy net by another version; empty: there is none.

    The tokens of both versions together are those of one: P-invariants bring back what the former version begins with,
    and the new version begins with the same. So its proof holds.

    Args:
        executor: The net, all of whose events have been taken.
        net: The new version, as written.
    """
    old, new = executor.net, expand(net)
    marked = old.initial_marking()
    for each in (old, new):
        if remote := [name for name, place in each.places.items() if place.remote]:
            return f"other nets mark its place {remote[0]}"
        for transition in each.transitions.values():
            if transition.remote_outputs:
                return f"its transition {transition.name} marks places of other nets"
            if looked := marked.keys() & {*transition.inhibitors, *transition.resets}:
                return (
                    f"its transition {transition.name} looks for the absence of tokens in {min(looked)}, or clears it"
                )
    begins = new.initial_marking()
    for place, tokens in marked.items():
        if begins.get(place) != tokens:
            return f"its place {place} begins with {tokens} tokens, that of the new version with {begins.get(place, 0)}"
    back = given_back(old, executor.marking())
    for name in sorted({*old.rest_places(), *marked}):
        if name not in marked or back.get(name) != marked[name]:
            return f"it is not proved that its place {name} comes back to the tokens that it began with"
    return ""


def begin_succession(former: Executor, successor: Executor) -> None:
    """Have a new version begin without the tokens of the former one."""
    for place, tokens in former.net.initial_marking().items():
        successor.rule.enabling.take_tokens(successor.rule.place[place], tokens)


def hand_over(former: Executor, successor: Executor) -> bool:
    """Move tokens at rest to the new version; return whether there were any.

    Those from which the former version only begins commands go at once, if it has none left to begin; the others when
    it is at rest.
    """
    rule, found = former.rule, False
    resting = bool(former.at_rest())
    if not resting and (former.due or rule.ledger.tape.waiting()):
        return False
    for place in former.net.initial_marking():
        number = rule.place[place]
        count = rule.enabling.tokens[number]
        begun = number not in rule.tokens.queues and all(
            t in rule.begins for t, _ in rule.tokens.compiled.consumers[number]
        )
        if count and (resting or begun):
            rule.enabling.take_tokens(number, count)
            successor.rule.mark_place(place, count, NO_LINEAGE)
            found = True
    return found


def count_on(former: Executor, successor: Executor) -> None:
    """Continue the numbers of the replaced net before any event: none is given twice.

    Others know actions and jobs by their numbers: a server would take the goal of one for that of the other.
    """
    successor.rule.notifier.sequence, successor.rule.ledger.count = former.sequence, former.rule.ledger.count


def rename(executor: Executor, net: Net, record: Record | None) -> None:
    """Have a net go on under another name.

    Args:
        executor: The net.
        net: The net as written, under that name.
        record: Takes what happens from now on.
    """
    rule = executor.rule
    executor.written, rule.net, rule.record = net, replace(rule.net, name=net.name, former=net.former), record
    rule.notifier.rename(net.name)
    for activity in rule.activities.values():
        activity.net = net.name
    for job in rule.ledger.jobs():
        if job.request is not None:
            job.request = replace(job.request, net=net.name)
