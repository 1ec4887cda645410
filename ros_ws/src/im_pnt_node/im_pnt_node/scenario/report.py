"""Report of a run of a scenario, and the parts of nets that runs have reached."""

from collections import defaultdict
from dataclasses import dataclass, field

from im_pnt.execution.jobs import CommandResult, Job


@dataclass
class ScenarioOrder:
    """A command or request of a scenario.

    Attributes:
        number: Its number, that of its step from 1.
        net: Its net.
        name: Symbol or service.
        is_request: Whether it is a request to a service.
        began: When it was written [s].
        arguments: Its arguments.
        job: Its job; None: it is a request.
        ended: When it ended [s]; None: it is open.
        result: How it ended.
    """

    number: int
    net: str
    name: str
    is_request: bool
    began: float
    arguments: dict[str, object]
    job: Job | None = None
    ended: float | None = None
    result: CommandResult | None = None


@dataclass
class Coverage:
    """Parts of nets reached by runs."""

    transitions: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    guards: dict[tuple[str, str], set[bool]] = field(default_factory=lambda: defaultdict(set))


@dataclass
class DrawnParts:
    """Parts of a scenario file, as they were drawn.

    Attributes:
        steps: Commands and requests with all arguments, and cancellations.
        answers: Answers by transition, in order.
        guards: Answers of guards, in order.
    """

    steps: list[dict[str, object]] = field(default_factory=list)
    answers: dict[str, list[dict[str, object]]] = field(default_factory=dict)
    guards: dict[str, list[bool]] = field(default_factory=dict)


@dataclass
class ScenarioReport:
    """Report of a run.

    Attributes:
        time: When it ended [s].
        firings: Time [s], net, and transition with a mark as of :data:`~im_pnt_node.scenario.file.MARKS`.
        orders: Commands and requests by the number of their step.
        marking: Marked places by net.
        unrest: Why a net is not at rest.
        troubles: What nets have complained of.
        not_begun: Numbers of steps whose ``while`` has not come.
        endless: Whether it was ended by the limit of firings.
        script: What was drawn, as parts of a scenario file: steps, answers, guards.
    """

    time: float = 0.0
    firings: list[tuple[float, str, str]] = field(default_factory=list)
    orders: dict[int, ScenarioOrder] = field(default_factory=dict)
    marking: dict[str, dict[str, int]] = field(default_factory=dict)
    unrest: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    not_begun: list[int] = field(default_factory=list)
    endless: bool = False
    script: DrawnParts = field(default_factory=DrawnParts)
