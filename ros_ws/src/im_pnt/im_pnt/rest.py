"""Whether a net is at rest, so that another may take its place; and if not, why."""

from dataclasses import dataclass

from im_pnt.firing import FiringRule


@dataclass(frozen=True, slots=True)
class Rest:
    """Whether a net is at rest; true where nothing keeps it from being so.

    Attributes:
        reasons: What does.
    """

    reasons: tuple[str, ...]

    def __bool__(self) -> bool:
        return not self.reasons

    def __str__(self) -> str:
        return "; ".join(self.reasons) or "at rest"


def rest_of(rule: FiringRule, marking: dict[str, int], waiting: int, calling: str) -> Rest:
    """Looks what keeps a net from being at rest.

    Args:
        rule: The net.
        marking: Its marked places.
        waiting: Events that it has not taken yet.
        calling: Transition whose function is being called, empty where none is.
    """
    reasons = []
    if waiting:
        reasons.append(f"{waiting} events wait to be taken")
    if calling:
        reasons.append(f"the action of transition {calling} is running")
    for activity in rule.activities.values():
        how = activity.state.value.replace("_", " ")
        reasons.append(f"{activity.action} of transition {activity.transition} is {how}")
    for job in rule.ledger.jobs():
        if job.request is not None:
            reasons.append(f"request {job.request.id} of net {job.request.caller_net} is open")
        else:
            reasons.append(f"command {job.symbol} (number {job.command.id}) is open")
    rest = rule.net.rest_places()
    hidden = {f"{a.transition}.{a.state}" for a in rule.activities.values()} | {f"{calling}.active"}
    for place, tokens in marking.items():
        if place not in rest and place not in hidden:
            reasons.append(f"place {place} holds {tokens} token{'s' if tokens > 1 else ''} and is no place of rest")
    return Rest(tuple(reasons))
