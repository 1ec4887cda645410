"""Done or failed: the reply of a service told apart, as it is in execution.

Verification lets a request end either way whatever its service did, which is safe. A probability needs the truth: here
``t_f.s.failed`` marks ``O.s.failed``, and the caller's ``t.failed`` alone takes what comes from there.
"""

from collections.abc import Mapping
from dataclasses import replace

from im_pnt.net import Net, Place, Role, Transition

_SUFFIX = ".failed"


def tell_outcomes_apart(flat: Net) -> tuple[Net, Mapping[str, str], Mapping[str, str]]:
    """Splits the replies of a composition's services into done and failed.

    Args:
        flat: Flat net of a composition.

    Returns:
        The net, and for each transition and each place that was added the one it was split from.
    """
    split = _shared_replies(flat)
    if not split:
        return flat, {}, {}

    def apart(arcs: Mapping[str, int]) -> dict[str, int]:
        return {f"{name}{_SUFFIX}" if name in split else name: weight for name, weight in arcs.items()}

    transitions: dict[str, Transition] = {}
    shown: dict[str, str] = {}
    for name, transition in flat.transitions.items():
        match transition.role:
            case Role.FINISH_FAILED:
                transitions[name] = replace(transition, outputs=apart(transition.outputs))
            case Role.FAILED:
                transitions[name] = replace(transition, inputs=apart(transition.inputs))
            case Role.RETURN:
                transitions[name] = transition
                twin = f"{name}{_SUFFIX}"
                shown[twin] = name
                inputs, outputs = apart(transition.inputs), apart(transition.outputs)
                transitions[twin] = replace(transition, name=twin, inputs=inputs, outputs=outputs)
            case _:
                transitions[name] = transition
    added = {f"{name}{_SUFFIX}": name for name in flat.places if name in split}
    places = {**flat.places, **{name: Place(name) for name in added}}
    return replace(flat, places=places, transitions=transitions), shown, added


def _shared_replies(flat: Net) -> frozenset[str]:
    """Names the places that mean a reply, whichever: O.s, and what RETURN gives to a caller's end and failure."""
    finished = {place for t in flat.transitions.values() if t.role is Role.FINISH for place in t.outputs}
    failed = {place for t in flat.transitions.values() if t.role is Role.FINISH_FAILED for place in t.outputs}
    returns = [t for t in flat.transitions.values() if t.role is Role.RETURN]
    taken = {place for t in returns for place in t.inputs}
    given = {place for t in returns for place in t.outputs}
    ends = {place for t in flat.transitions.values() if t.role is Role.END for place in t.inputs}
    failures = {place for t in flat.transitions.values() if t.role is Role.FAILED for place in t.inputs}
    return frozenset((finished & failed & taken) | (given & ends & failures))
