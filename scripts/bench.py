"""Measures the machine; run it through ``bench.sh``."""

import argparse
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parent
BARE_NODE = "import rclpy; rclpy.init(); rclpy.create_node('bare'); rclpy.shutdown()"


def run(name: str, *arguments: object) -> float:
    """Run a script to its end; returns how long it took [s]."""
    begun = time.monotonic()
    done = subprocess.run(
        ["bash", str(SCRIPTS / f"{name}.sh"), *map(str, arguments)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"scripts/{name}.sh ended with code {done.returncode}:\n{done.stdout}{done.stderr}")
    return time.monotonic() - begun


def bare_node() -> float:
    """Baseline of start-up: a process with one node and nothing in it [s]."""
    begun = time.monotonic()
    subprocess.run([sys.executable, "-c", BARE_NODE], check=True)
    return time.monotonic() - begun


def memory() -> float:
    """Memory of the machine, shared pages counted once [MiB]."""
    total = 0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = (process / "environ").read_bytes().split(b"\0")
            if f"IM_RUN_DIR={os.environ['IM_RUN_DIR']}".encode() not in environment:
                continue
            if int(process.name) == os.getpid():
                continue
            for line in (process / "smaps_rollup").read_text().splitlines():
                if line.startswith("Pss:"):
                    total += int(line.split()[1])
        except OSError:
            continue
    return total / 1024


def report() -> dict:
    """The newest report."""
    return json.loads((Path(os.environ["IM_RESULTS_DIR"]) / "latest" / "report.json").read_text())


def servo() -> dict[str, str]:
    """What ``/diagnostics`` says of the servo."""
    script = (
        "import json, rclpy\n"
        "from diagnostic_msgs.msg import DiagnosticArray\n"
        "from rclpy.task import Future\n"
        "from im_core.ros.run import Spinner\n"
        "rclpy.init()\n"
        "node = rclpy.create_node('bench')\n"
        "spinner = Spinner([node])\n"
        "found = {}\n"
        "def note(message):\n"
        "    for status in message.status:\n"
        "        if status.name.startswith('mcs'):\n"
        "            found.update({value.key: value.value for value in status.values})\n"
        "            spinner.request_stop()\n"
        "node.create_subscription(DiagnosticArray, '/diagnostics', note, 10)\n"
        "spinner.spin()\n"
        "print(json.dumps(found))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=30)
    return json.loads(done.stdout)


def speed(commands: int) -> None:
    """Start-up, the 40-pose command at clock factor 0, memory."""
    base = bare_node()
    ready = run("start", "--factor", 0)
    try:
        print(
            f"machine ready            {ready:6.1f} s   {ready / base:6.1f} x a process with one bare node ({base:.2f} s)"
        )
        for number in range(1, commands + 1):
            wall = run("calibrate_camera")
            timing = report()["timing"]
            print(
                f"calibrate_camera, run {number}  {wall:6.1f} s   {timing['simulated_s'] / timing['wall_s']:6.1f} x"
                f" simulated time ({timing['simulated_s']:.1f} s); memory {memory():.0f} MiB"
            )
        print("where the time of the last run went:")
        for name, step in list(timing["steps"].items())[:8]:
            print(
                f"  {name:45s} {step['wall_s']:7.2f} s   {step['count']:4d} times   {step['simulated_s']:7.2f} s simulated"
            )
    finally:
        run("stop")


def real_time() -> None:
    """The servo's period over a whole command at clock factor 1."""
    run("start", "--factor", 1)
    try:
        run("calibrate_camera")
        seen = servo()
    finally:
        run("stop")
    print("servo in real time, a whole command:")
    for key, value in sorted(seen.items()):
        print(f"  {key:30s} {value}")


def accuracy(seeds: int) -> None:
    """True errors over predicted ones, RMS over seeds."""
    ratios: dict[str, list[float]] = {"triangulation_mm": [], "reprojection_px": []}
    chi2 = []
    for seed in range(1, seeds + 1):
        run("demo", "--seed", seed)
        result = report()
        chi2.append(result["chi2_per_dof"])
        for key, values in ratios.items():
            values.append(result["truth_error"][key] / result["expected_error"][key])
        print(
            f"seed {seed:3d}: {result['points_used']} points, chi2/dof {chi2[-1]:.3f}, true over predicted: triangulation"
            f" {ratios['triangulation_mm'][-1]:.2f}, reprojection {ratios['reprojection_px'][-1]:.2f}",
            flush=True,
        )
    for key, values in ratios.items():
        rms = math.sqrt(sum(value**2 for value in values) / len(values))
        print(f"{key}: true over predicted, RMS over {seeds} seeds: {rms:.2f}")
    print(f"chi2/dof, mean over {seeds} seeds: {sum(chi2) / len(chi2):.3f}")


def main() -> int:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(prog="bench.sh", description="Measures the machine.")
    parser.add_argument("--seeds", type=int, default=0, help="accuracy over this many seeds")
    parser.add_argument("--commands", type=int, default=1, help="commands in a row (default 1)")
    parser.add_argument("--real-time", action="store_true", help="the servo's timing in real time, too")
    arguments = parser.parse_args()
    try:
        if arguments.seeds:
            accuracy(arguments.seeds)
            return 0
        speed(arguments.commands)
        if arguments.real_time:
            real_time()
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
