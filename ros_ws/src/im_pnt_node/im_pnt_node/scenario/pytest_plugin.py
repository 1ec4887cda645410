"""Plug-in of pytest: collects scenario files, each scenario a test. It is there where im_pnt_node is installed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from im_pnt_node.scenario.file import Scenario, ScenarioSet

_SUFFIX = ".test.yml"  # nothing of ours is imported before there is such a file


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Return the collector of a scenario file."""
    if not file_path.name.endswith(_SUFFIX):
        return None
    return _ScenarioFile.from_parent(parent, path=file_path)


class _ScenarioFile(pytest.File):
    """Collector of the scenarios of a file."""

    def collect(self) -> Iterable[pytest.Item]:
        """Yield a test for each scenario."""
        from im_core import plugins
        from im_core.errors import ImError
        from im_pnt_node.scenario.file import load_scenarios

        try:
            scenarios = load_scenarios(self.path)
        except ImError as error:
            raise self.CollectError(error.message) from error
        plugins.find_beside(net.source for net in scenarios.nets)
        for scenario in scenarios.scenarios:
            test = _Test.from_parent(self, name=scenario.name)
            test.scenarios, test.scenario = scenarios, scenario
            yield test


class _ScenarioError(AssertionError):
    """A scenario has not ended as expected."""


class _Test(pytest.Item):
    """Test of one scenario."""

    scenarios: ScenarioSet
    scenario: Scenario

    def runtest(self) -> None:
        """Run the scenario."""
        from im_pnt.expression.types import installed_types
        from im_pnt_node.scenario.report import Coverage
        from im_pnt_node.scenario.verdict import judge

        verdict = judge(self.scenarios, self.scenario, Coverage(), installed_types())
        if verdict.complaints:
            raise _ScenarioError(verdict.told(f"{self.path}:{self.scenario.line}"))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: object = None) -> str:
        """Return the text of a failure, without a trace."""
        if isinstance(excinfo.value, _ScenarioError):
            return str(excinfo.value)
        return str(super().repr_failure(excinfo))

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return file, line from 0, and name."""
        return self.path, self.scenario.line - 1, self.name
