"""First difference between a re-run and the recording."""

from dataclasses import dataclass


@dataclass
class Difference(BaseException):  # nothing that catches what foreign code raises may catch it
    """The first difference.

    Attributes:
        node: Node of the net.
        net: The net.
        transition: The transition; empty where it is none's.
        command: Number of the command that it works for, 0: none.
        stamp: Testbed time [s].
        recorded: What the bag has.
        now: What the net does now.
        reason: Why, as far as it can be told.
    """

    node: str
    net: str
    transition: str
    command: int
    stamp: float
    recorded: str
    now: str
    reason: str

    def __str__(self) -> str:
        """The report."""
        where = f"net {self.net}" + (f", transition {self.transition}" if self.transition else "")
        command = f", command {self.command}" if self.command else ""
        lines = [
            f"differs at {self.stamp:.3f} s: {where}{command} ({self.node})",
            f"  the bag:  {self.recorded}",
            f"  now:      {self.now}",
        ]
        return "\n".join([*lines, f"  because:  {self.reason}"] if self.reason else lines)


def first_difference(recorded: object, now: object, where: str = "") -> str:
    """Return the first difference of JSON data: ``memory.loop[1]: 4, now 5``; empty for equal data."""
    if isinstance(recorded, dict) and isinstance(now, dict):
        for key in [*recorded, *(key for key in now if key not in recorded)]:
            if key not in now or key not in recorded:
                how = "there, now missing" if key in recorded else "not there, now there"
                return f"{where}.{key}: {how}".strip(".")
            if told := first_difference(recorded[key], now[key], f"{where}.{key}"):
                return told.lstrip(".")
        return ""
    if isinstance(recorded, list) and isinstance(now, list) and len(recorded) == len(now):
        pairs = enumerate(zip(recorded, now, strict=True))
        return next((told for rank, (a, b) in pairs if (told := first_difference(a, b, f"{where}[{rank}]"))), "")
    same = type(recorded) is type(now) and recorded == now
    return "" if same else f"{where.lstrip('.')}: {_short(recorded)}, now {_short(now)}".lstrip(": ")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 160 else f"{text[:157]}..."
