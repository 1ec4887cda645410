"""Statements on nets before a run: permission to run, expected durations, and the next firings.

For whoever writes nets or decides whether to load them. Knows ``im_core`` and the model, files and verdict types of
``im_pnt``; nothing of ROS. Folders, from the lowest: ``structure`` (what the arcs tell), ``composition`` (several nets
as one, closed by their environment), ``guards`` (values that pass no guard, by z3), ``search`` and
``symbolic`` (markings, listed or in decision diagrams), ``verify`` (may they run: ``verify.verdict.verify``),
``timed`` (stochastic nets), ``recorded`` (nets out of bags), ``simulation``, and the command ``pnt`` in ``cli``.

A net and its verdict; the examples of the names below go on with its variables:

    >>> from im_pnt import parse_net
    >>> from im_pnt_analysis import *
    >>> oven = parse_net('''
    ... net: oven
    ... places: {cold: 1, full: , hot: }
    ... transitions:
    ...   load: {symbol: bake, in: [cold], out: [full]}
    ...   bake: {in: [full], out: [hot], delay: 4.0}
    ...   empty: {in: [hot], out: [cold], delay: 1.0, emit: bake_done}
    ... ''')
    >>> report = verify_to_load([oven])
    >>> report.ok, report.states, report.place_bounds
    (True, 3, {'cold': 1, 'full': 1, 'hot': 1})
"""

from typing import TYPE_CHECKING

from im_core.plugins import import_at_use

if TYPE_CHECKING:
    from im_pnt_analysis.composition.compose import compose
    from im_pnt_analysis.search.limits import SearchLimits
    from im_pnt_analysis.simulation.replay import FiringSequence, replay
    from im_pnt_analysis.simulation.simulate import simulate, summarise
    from im_pnt_analysis.timed.durations import CommandDuration, expected_command
    from im_pnt_analysis.timed.measurement import compare
    from im_pnt_analysis.timed.steady import steady_state
    from im_pnt_analysis.verify.load import verify_to_load
    from im_pnt_analysis.verify.report import Report

__all__ = ["CommandDuration", "FiringSequence", "Report", "SearchLimits", "compare", "compose", "expected_command"]
__all__ += ["replay", "simulate", "steady_state", "summarise", "verify_to_load"]

__getattr__ = import_at_use(
    __name__,
    {
        "composition.compose": ("compose",),
        "search.limits": ("SearchLimits",),
        "simulation.replay": ("FiringSequence", "replay"),
        "simulation.simulate": ("simulate", "summarise"),
        "timed.durations": ("CommandDuration", "expected_command"),
        "timed.measurement": ("compare",),
        "timed.steady": ("steady_state",),
        "verify.report": ("Report",),
        "verify.load": ("verify_to_load",),
    },
)
