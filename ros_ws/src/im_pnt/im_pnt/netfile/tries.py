"""Several tries of an action, as places and transitions for the usual verification."""

from dataclasses import replace

from im_pnt.model.net import Guard, Place, Transition


def written_out(transition: Transition, tries: int, escalate: str | None) -> tuple[list[Place], list[Transition]]:
    """Write out the tries of a transition ``t``.

    The first try fails to ``t_failed_1``, from where ``t_2`` takes the token, and so on; the last one fails to where
    ``t`` would. A command that was cancelled is not tried again: ``t_cancelled_1`` takes the token there at once.

    Args:
        transition: The transition as read.
        tries: How often its action is tried.
        escalate: Place for failures of transitions without ``on_failure``.

    Returns:
        The places between the tries, and the transitions, the first try first.
    """
    name, cancelled = transition.name, "cancelled"
    failed = [f"{name}_failed_{number}" for number in range(1, tries)]
    if not failed:
        return [], [transition]
    given_up = transition.on_failure or ({} if escalate is None else {escalate: 1})
    made = [replace(transition, on_failure={failed[0]: 1})]
    for number, place in enumerate(failed, 1):
        last = number == len(failed)
        again = replace(
            transition,
            name=f"{name}_{number + 1}",
            inputs={place: 1},
            inhibitors={},
            resets=(),
            guard=Guard(cancelled, negated=True),
            symbol=None,  # the first try has read it
            symbol_of=None,
            symbol_expires=None,
            on_failure=transition.on_failure if last else {failed[number]: 1},
            weight=1.0,
            strategy=None,
            retry_of=transition.retry_of or name,
            origin=f"{name}_{number + 1}",
        )
        end = f"{name}_cancelled_{number}"
        guard = Guard(cancelled)
        line, file = transition.line, transition.file
        made += [again, Transition(end, {place: 1}, given_up, guard=guard, origin=end, line=line, file=file)]
    return [Place(place) for place in failed], made
