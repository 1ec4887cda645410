"""What hosts cost: time to READY over one, two and three of them, and what crosses between them at rest."""

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.chaos import over_hosts
from bench.chaos.hosts import CABLE, Host
from bench.figures import Line
from im_core import clock

#: How long a machine settles, and how long it is then looked at [s].
_SETTLED_S, _LOOKED_S = 10.0, 20.0
#: What ``start.sh`` says of its parts: the barriers end LOAD, CONFIGURE and START.
_READY = re.compile(r"ready after ([0-9.]+) s")
_PARTS = {"processes and discovery": "LOAD", "configuration": "CONFIGURE", "first service": "START"}


def host_lines() -> Iterator[Line]:
    """Start the machine over one, two and three hosts.

    Raises:
        ImError: It does not start.
    """
    for count in over_hosts.DEPLOYMENTS:
        with tempfile.TemporaryDirectory() as folder, over_hosts.running(count, 0.0, Path(folder)) as machine:
            over = f"{count} host{'s' if count > 1 else ''}"
            (ready,) = _READY.findall(machine.told)
            yield Line(f"ready over {over}", float(ready), "s")
            for part, phase in _PARTS.items():
                (took,) = re.findall(rf"{part} ([0-9.]+) s", machine.told)
                yield Line(f"  {phase} with its barrier", float(took), "s")
            if count > 1:
                clock.sleep(_SETTLED_S)
                before = [_carried(host) for host in machine.network.hosts]
                clock.sleep(_LOOKED_S)
                after = [_carried(host) for host in machine.network.hosts]
                size, frames = (sum(b[i] - a[i] for a, b in zip(before, after, strict=True)) for i in (0, 1))
                yield Line("  all that crosses between hosts at rest", size / _LOOKED_S / 1e3, "kB/s")
                yield Line("  in frames", frames / _LOOKED_S, "1/s")


def _carried(host: Host) -> tuple[int, int]:
    """Bytes and frames that the cable of a host has sent."""
    for line in Path(f"/proc/{host.pid}/net/dev").read_text(encoding="ascii").splitlines():
        name, _, numbers = line.partition(":")
        if name.strip() == CABLE:
            return int(numbers.split()[8]), int(numbers.split()[9])
    return 0, 0
