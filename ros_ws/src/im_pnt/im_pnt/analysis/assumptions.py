"""What the verdict on a net takes for granted about guards, tapes, actions and priorities."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from im_pnt.net import Net, Role


def assumptions(nets: Sequence[Net]) -> Iterator[str]:
    """Says what is taken for granted.

    Args:
        nets: The nets, expanded.
    """
    if guarded := _names(net for net in nets if net.guards()):
        yield (
            f"guards ({guarded}) may be true or false at any time: bounds and safety hold whatever they say; liveness "
            "and the return of resources hold unless a guard stays as it is for ever"
        )
    for net in nets:
        yield from open_guards(net)
    if reading := _names(net for net in nets if net.symbols()):
        yield (
            f"tapes ({reading}) are free, any symbol may come at any time: bounds and safety hold for every tape; "
            "liveness holds where each symbol comes again and again"
        )
    if acting := _names(net for net in nets if any(t.role is Role.START for t in net.transitions.values())):
        yield f"actions ({acting}) end, fail, or come in doubt, which is then decided either way"
    if ordered := _names(net for net in nets if len({t.priority for t in net.transitions.values()}) > 1):
        yield f"priorities ({ordered}) are not looked at: whatever is enabled may go first"


def _names(nets: Iterable[Net]) -> str:
    return ", ".join(net.name for net in nets)


def open_guards(net: Net) -> Iterator[str]:
    """Names the guards that have no counterpart, and might keep a net waiting for ever."""
    guarded = [t for t in net.transitions.values() if t.guard]
    for transition in guarded:
        assert transition.guard is not None
        opposite = replace(transition.guard, negated=not transition.guard.negated)
        rivals = (t for t in net.transitions.values() if t.inputs.keys() & transition.inputs.keys() and t != transition)
        if not any(t.guard == opposite or (t.guard is None and t.symbol is None) for t in rivals):
            yield (
                f"guard '{transition.guard}' of transition {transition.origin} of net {net.name} becomes true: "
                "nothing else takes the tokens while it is false"
            )
