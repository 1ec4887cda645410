"""``pnt policy``: which of contending transitions to take, for the most reward."""

import argparse
import json
from dataclasses import asdict

from im_core.errors import ImError
from im_pnt.netfile import load_net
from im_pnt_analysis.cli.terminal import OK
from im_pnt_analysis.timed.policy import BestPolicy, Rewards, best_policy

_DESCRIPTION = """Computes which of the transitions that contend for a token to take in which marking, so that a net
gains the most: in one command from its symbol to its answer (--command), or a second in the long run.

  scripts/im pnt policy docs/nets/delivery.yaml --command deliver              the soonest answer
  scripts/im pnt policy cell.yaml --reward put=10 --reward drop!=-50 --reward waiting=-0.1/s

A reward NAME=VALUE is of each end of a transition, NAME! of its failure, NAME+ of its begin; NAME=VALUE/s is of each
token of a place and each second. Without one, a command loses 1 a second. Chosen are transitions that fire at once,
without guard and symbol, and with weight 1 or a strategy; of others that contend, guards and weights decide. --choose
names them instead. The weights that are printed take each as often as the policy does, in whatever marking."""

_SHOWN = 20


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", metavar="FILE", help="net files; several are composed")
    parser.add_argument("--command", dest="symbol", metavar="SYMBOL", help="one command from its symbol to its answer")
    parser.add_argument("--reward", action="append", default=[], metavar="NAME=VALUE[/s]", help="reward, or cost < 0")
    parser.add_argument("--choose", nargs="+", metavar="NAME", help="the transitions that are chosen")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--all", action="store_true", help=f"all decisions, not {_SHOWN}")


def run(options: argparse.Namespace) -> int:
    """Compute the policy of net files."""
    rewards = _rewards(options.reward, by_time=options.symbol is not None)
    nets = [load_net(file) for file in options.files]
    policy = best_policy(nets, rewards, command=options.symbol, chosen=options.choose)
    name = "+".join(net.name for net in nets)
    per = f"each {options.symbol}" if options.symbol else "each second"
    shown = len(policy.decisions) if options.all else _SHOWN
    print(json.dumps(asdict(policy), indent=1) if options.json else f"{name}: {_readable(policy, per, shown)}")
    return OK


def _rewards(written: list[str], *, by_time: bool) -> Rewards:
    """Read the rewards.

    Raises:
        ImError: One is none.
    """
    firings: dict[str, float] = {}
    seconds: dict[str, float] = {}
    for text in written:
        name, _, value = text.rpartition("=")
        try:
            kept = seconds if value.endswith("/s") else firings
            kept[name] = float(value.removesuffix("/s"))
        except ValueError:
            name = ""
        if not name:
            raise ImError(f"--reward {text}: NAME=VALUE or NAME=VALUE/s is needed, such as put=10", code="input")
    if not written and not by_time:
        raise ImError(
            "say what is to be gained with --reward NAME=VALUE, or which --command is to end soon", code="input"
        )
    return Rewards(firings, seconds, 0.0 if written else -1.0)


def _readable(policy: BestPolicy, per: str, shown: int) -> str:
    lines = [
        f"{policy.value:.6g} {per} with the best choices",
        f"  as it is       {policy.present:.6g}, with the weights of the net",
        f"  with weights   {policy.weighted:.6g}: "
        + (", ".join(f"{name} {weight:g}" for name, weight in policy.weights.items()) or "there is nothing to choose"),
    ]
    for decision in policy.decisions[:shown]:
        marking = ", ".join(f"{place}={count}" for place, count in decision.marking.items())
        taken = [name if share > 0.999 else f"{name} {share:.3g}" for name, share in decision.options.items() if share]
        left = [name for name, share in decision.options.items() if not share]
        lines.append(f"  choose         {', '.join(taken)} (not {', '.join(left)}) with {marking}")
    if len(policy.decisions) > shown:
        lines.append(f"  left out       {len(policy.decisions) - shown} decisions (--all)")
    lines.extend(f"  assumed        {text}" for text in policy.assumptions)
    return "\n".join(lines)
