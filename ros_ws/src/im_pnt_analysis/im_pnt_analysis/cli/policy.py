"""``pnt policy``: which of contending transitions to take, for the most reward."""

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from im_core.errors import ImError
from im_core.files import read_text, write_whole
from im_pnt.errors import NetFileError
from im_pnt.model.net import Net, Transition
from im_pnt.netfile import describe, load_net, parse_net
from im_pnt_analysis.cli.terminal import OK
from im_pnt_analysis.timed.policy import BestPolicy, Rewards, best_policy

_DESCRIPTION = """Computes which of the transitions that contend for a token to take in which marking, so that a net
gains the most: in one command from its symbol to its answer (--command), or a second in the long run.

  scripts/im pnt policy docs/nets/pick_and_place.yaml --command pick            the soonest answer
  scripts/im pnt policy cell.yaml --reward put=10 --reward drop!=-50 --reward waiting=-0.1/s

A reward NAME=VALUE is of each end of a transition, NAME! of its failure, NAME+ of its begin; NAME=VALUE/s is of each
token of a place and each second. Without one, a command loses 1 a second. Chosen are transitions that fire at once,
without guard and symbol, and with weight 1 or a strategy; of others that contend, guards and weights decide. --choose
names them instead. The weights that are printed take each as often as the policy does, in whatever marking; --write
puts them into the files, as `weight` of the transitions."""

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
    parser.add_argument("--write", action="store_true", help="write the weights into the net files")
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
    if options.write:
        texts = _with_weights(nets, policy.weights)
        for file, text in texts.items():
            write_whole(file, text)
            if not options.json:
                print(f"  written        {file}")
    return OK


def _with_weights(nets: Sequence[Net], weights: Mapping[str, float]) -> dict[Path, str]:
    """Return the texts of net files with other weights of transitions, all else as it is written.

    Raises:
        ImError: A transition is written in a way that is not edited, as one that comes from a part.
    """
    texts: dict[Path, str] = {}
    for net in nets:
        own = {t: weights[n] for t in net.transitions for n in (t, f"{net.name}.{t}") if n in weights}
        if not own:
            continue
        file = Path(net.source)
        lines = read_text(file).splitlines(keepends=True)
        for each in sorted((net.transitions[name] for name in own), key=lambda each: -each.line):
            _write_weight(lines, each, f"{own[each.name]:g}")
        text = "".join(lines)
        transitions = {n: replace(t, weight=own.get(n, t.weight)) for n, t in net.transitions.items()}
        try:
            right = describe(parse_net(text, net.source, file)) == describe(replace(net, transitions=transitions))
        except NetFileError:
            right = False
        if not right:
            told = ", ".join(f"{name} {weight:g}" for name, weight in own.items())
            raise ImError(f"{file}: write the weights yourself, its form is not known: {told}", code="input")
        texts[file] = text
    return texts


def _write_weight(lines: list[str], transition: Transition, weight: str) -> None:
    """Write a weight into the lines of a net, in the place of the former one, or behind the name."""
    first = transition.line - 1
    indent = len(lines[first]) - len(lines[first].lstrip())
    end = first + 1
    while end < len(lines) and (not lines[end].strip() or len(lines[end]) - len(lines[end].lstrip()) > indent):
        end += 1
    block = "".join(lines[first:end])
    changed, found = re.subn(r"\bweight: *[^\s,}]+", f"weight: {weight}", block, count=1)
    if not found:
        brace = block.find("{")
        if brace >= 0 and not block[block.find(":") + 1 : brace].strip():
            changed = f"{block[: brace + 1]}weight: {weight}, {block[brace + 1 :]}"
        else:
            name, _, rest = block.partition("\n")
            inner = len(rest) - len(rest.lstrip(" "))
            changed = f"{name}\n{' ' * inner}weight: {weight}\n{rest}"
    lines[first:end] = [changed]


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
