"""``pnt prove``: proof for the start of a machine, with the user's cache of proofs."""

import argparse

from im_core.clock import cpu
from im_core.options import computing_seconds
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK, REFUSED, UNPROVED, EndOnInterrupt
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.load import LOAD_LIMITS, verify_to_start
from im_pnt_analysis.verify.report import refusal_text

_DESCRIPTION = f"""Verifies the nets of a machine as its start does: each alone, and those that talk to each other
together. What was proved of nets is kept ($XDG_CACHE_HOME/im/proofs); it is not proved again while they are unchanged.

A machine gives each verification {LOAD_LIMITS.seconds:g} s of CPU time. Nets that need more are proved here once, with
a longer --timeout; the machine then finds the proof.

Exit code: 0 verified, 1 refused, 2 a file or an option is wrong, 3 not refused, but not proved either."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", metavar="FILE", help="all net files of the machine")
    parser.add_argument(
        "--timeout",
        type=computing_seconds,
        default=LOAD_LIMITS.seconds,
        metavar="S",
        help="CPU time for each verification [s] (%(default)g); with more of it, more markings are listed, too",
    )


def run(options: argparse.Namespace) -> int:
    """Verify net files; the last printed line is the verdict."""
    began = cpu()
    more = max(1.0, options.timeout / LOAD_LIMITS.seconds)
    limits = SearchLimits(states=int(more * LOAD_LIMITS.states), seconds=options.timeout)
    anew, unproved = 0, ""
    with EndOnInterrupt("\npnt: verification interrupted, nothing is decided"):
        nets = [load_net(file) for file in options.files]
        for report in verify_to_start(nets, limits):
            if report.refusals:
                print(refusal_text(report))
                return REFUSED
            print(report.sentence, flush=True)
            anew += not report.proved_before
            unproved = unproved or (report.sentence if report.unproved else "")
    took = f"verified in {cpu() - began:.2f} s of CPU time" if anew else "unchanged since verified"
    print(unproved or f"{len(nets)} {'net' if len(nets) == 1 else 'nets'} {took}")
    return UNPROVED if unproved else OK
