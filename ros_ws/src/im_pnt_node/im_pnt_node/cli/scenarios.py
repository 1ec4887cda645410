"""``pnt test``: run scenarios of nets."""

import argparse
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from pathlib import Path

from im_core import plugins
from im_core.clock import monotonic
from im_core.errors import ConfigError
from im_core.files import write_whole
from im_pnt.expression.types import installed_types
from im_pnt_node.scenario.file import SUFFIX, load_scenarios
from im_pnt_node.scenario.report import Coverage
from im_pnt_node.scenario.verdict import judge, unreached

PASSED, FAILED = 0, 1

_DESCRIPTION = f"""Runs the scenarios beside nets: what comes when, what actions answer, what is expected. They run on
the engine of the nodes, in virtual time, with mocked actions; nothing moves, and an hour takes a moment.

  scripts/im pnt test docs/nets/tasks                     every scenario file (*{SUFFIX}) of a folder
  scripts/im pnt test docs/nets/tasks/confirm.yaml        that of a net, confirm{SUFFIX}
  scripts/im pnt test confirm{SUFFIX} --only said_no
  scripts/im pnt test nets --junit results/nets.xml       for a build server; pytest collects the files, too

A scenario file, here pick{SUFFIX} beside pick.yaml:

  scenarios:
    picks_the_second_time:
      steps: [{{symbol: pick, arguments: {{limit: 4.0}}, takes: 3.0}}]
      answers:
        look: {{answer: {{force: 3.2}}, after: 1.0}}
        reach: [{{failure: slipped}}, {{}}]                  # fails, then ends well
      expect: {{order: [look, "reach!", reach_2], marking: {{arm: 1}}}}
    cancelled_on_the_way:
      steps:
        - {{symbol: pick, ends: cancelled}}
        - {{while: reach, at: 0.5, cancel: pick}}          # half a second after reach has begun
    ends_whatever_happens:
      steps: [{{symbol: pick}}]                            # arguments are drawn,
      random: 200                                        # answers, failures and cancellations, too

The report says which transitions never fired, and which guards were never true or never false. docs/testing.md
tells all keys. Exit code: 0 all passed, 1 not, 2 a file or an option is wrong."""


def add(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser of ``pnt``."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = commands.add_parser("test", help="run scenarios of nets", description=_DESCRIPTION, formatter_class=raw)
    parser.set_defaults(run=run)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="scenario files, their nets, or folders")
    parser.add_argument("--only", metavar="NAME", help="run the scenarios of this name alone")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="same seed, same draws (0)")
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write the results as JUnit XML")


def run(options: argparse.Namespace) -> int:
    """Run scenario files.

    Raises:
        ImError: There is no such file or scenario, or a file is wrong.
    """
    files = [file for given in options.files for file in _scenario_files(given)]
    sets = [load_scenarios(file) for file in dict.fromkeys(files)]
    names = {scenario.name for each in sets for scenario in each.scenarios}
    if options.only is not None and options.only not in names:
        raise ConfigError(f"there is no scenario '{options.only}'; there are {', '.join(sorted(names))}")
    plugins.find_beside(net.source for each in sets for net in each.nets)
    types, failed, passed = installed_types(), 0, 0
    suites = ElementTree.Element("testsuites")
    for each in sets:
        coverage = Coverage()
        suite = ElementTree.SubElement(suites, "testsuite", name=str(each.path))
        for scenario in each.scenarios:
            if options.only not in (None, scenario.name):
                continue
            began = monotonic()
            verdict = judge(each, scenario, coverage, types, options.seed)
            case = ElementTree.SubElement(suite, "testcase", classname=str(each.path), name=scenario.name)
            case.set("time", f"{monotonic() - began:.3f}")
            where = f"{each.path}:{scenario.line}"
            many = f" ({verdict.runs} runs)" if verdict.drawn else ""
            if verdict.complaints:
                failed += 1
                text = verdict.told(where)
                ElementTree.SubElement(case, "failure", message=verdict.complaints[0]).text = text
                print(f"FAILED  {where}: {scenario.name}{many}\n{text}")
            else:
                passed += 1
                print(f"passed  {where}: {scenario.name}{many}")
        reached, total, left = unreached(each, coverage)
        print(f"        {each.path.name}: {reached} of {total} transitions and sides of guards reached")
        for text in left if options.only is None else ():
            print(f"        {text}")
        suite.set("tests", str(len(suite)))
        suite.set("failures", str(sum(case.find("failure") is not None for case in suite)))
    if options.junit is not None:
        write_whole(options.junit, ElementTree.tostring(suites, encoding="unicode", xml_declaration=True))
    print(f"{passed} passed, {failed} failed")
    return FAILED if failed else PASSED


def _scenario_files(given: Path) -> Sequence[Path]:
    """Return the scenario files that a file or folder stands for.

    Raises:
        ConfigError: There is none.
    """

    def found() -> Iterator[Path]:
        if given.is_dir():
            yield from sorted(given.rglob(f"*{SUFFIX}"))
        elif given.name.endswith(SUFFIX):
            yield given
        elif (beside := given.with_name(f"{given.stem}{SUFFIX}")).exists():
            yield beside

    files = list(found())
    if not files:
        what = f"*{SUFFIX} in it" if given.is_dir() else f"{given.stem}{SUFFIX} beside it"
        raise ConfigError(f"{given}: there is no {what}; scripts/im pnt test --help shows one", file=str(given))
    return files
