"""Experience with strategies: alternatives chosen by a learned probability of success (paper, section 2).

Each outcome of a transition with a strategy is counted in a Beta distribution whose counts decay, so that old outcomes
weigh less than new ones.
"""

from im_pnt.model.net import Strategy


class StrategyBook:
    """Experience with strategies, by net and transition.

    Attributes:
        learned: Successes and failures of strategies that have had an outcome, by ``net.transition``.
    """

    def __init__(self) -> None:
        self.learned: dict[str, tuple[float, float]] = {}

    def counts(self, net: str, transition: str, strategy: Strategy) -> tuple[float, float]:
        """Return the successes and failures counted so far, including counts from before the first run."""
        return self.learned.get(f"{net}.{transition}", (strategy.successes, strategy.failures))

    def mean_success(self, net: str, transition: str, strategy: Strategy) -> float:
        """Return the expected probability of success, 0.5 without any count."""
        successes, failures = self.counts(net, transition, strategy)
        return successes / (successes + failures) if successes + failures > 0.0 else 0.5

    def outcome(self, net: str, transition: str, strategy: Strategy, success: bool) -> None:
        """Count an outcome."""
        successes, failures = (count * strategy.decay for count in self.counts(net, transition, strategy))
        self.learned[f"{net}.{transition}"] = (successes + success, failures + (not success))
