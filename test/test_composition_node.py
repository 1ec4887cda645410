"""No machine starts with nets that may not run together, and no node stays down for a proof that was found before."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter

from im_bringup.machine import leftovers
from im_bringup.machine import machine_state as machine
from im_core.ros import qos
from im_pnt.netfile import load_net
from im_pnt_analysis import SearchLimits, verify_to_load
from im_pnt_node.ros.node import PntNode

NOTHING = SearchLimits(states=1, seconds=0.0)
RING = """
net: ring
places: {a: 60, b: , c: }
transitions: {t: {in: a, out: b, symbol: go}, u: {in: b, out: c}, v: {in: c, out: a}}
"""


@pytest.fixture
def hurried(ros, tmp_path):
    """``hurried()``: a node with a net of many markings, and no time to verify it."""
    file = tmp_path / "ring.yaml"
    file.write_text(RING)

    def make():
        alone = [Parameter("standalone", value=True)]
        return ros(PntNode("hurried", [file], verifier=lambda n: verify_to_load(n, NOTHING), parameter_overrides=alone))

    make.net = lambda: load_net(file)
    return make


def test_a_node_that_has_no_time_to_verify_runs_where_its_net_is_unchanged(hurried, wait_until):
    first = hurried()
    assert "net ring is not proved: " in wait_until(lambda: first.failed, "the refusal")
    assert verify_to_load([hurried.net()]).ok
    again = hurried()
    wait_until(lambda: again.ready, "the node to be ready")


def test_what_runs_without_proof_is_said_in_diagnostics(hurried, ros, wait_until, monkeypatch, tmp_path):
    monkeypatch.setenv("IM_UNPROVED", "1")
    monkeypatch.setenv("IM_CACHE_DIR", str(tmp_path / "cache"))
    heard = []
    listener = Node("listener")
    listener.create_subscription(DiagnosticArray, "/diagnostics", lambda m: heard.extend(m.status), qos.STATUS)
    ros(listener)
    node = hurried()
    wait_until(lambda: node.ready, "the node to be ready")
    status = wait_until(lambda: next((s for s in heard if s.name == "hurried: nets"), None), "the diagnosis")
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith("net ring is not proved: ")


PROGRAM = """#!{python}
import sys
from im_core.ros import run
from im_pnt_node.ros.node import PntNode
from im_pnt_analysis import verify_to_load
sys.exit(run.main(lambda: PntNode("{name}", ["{file}"], verifier=verify_to_load)))
"""


def lab(folder: Path, nets: dict[str, str]) -> tuple[Path, dict[str, str]]:
    """A ROS package with a node for each net, a deployment of all, and the environment in which it is found."""
    programs = folder / "lib" / "lab"
    programs.mkdir(parents=True)
    lines = ["clock_factor: 1.0", "hosts:", "  localhost:"]
    for name, text in nets.items():
        file = folder / f"{name}.yaml"
        file.write_text(text)
        program = programs / name
        program.write_text(PROGRAM.format(python=sys.executable, name=name, file=file))
        program.chmod(0o755)
        lines.append(f"    {name}: {{{name}: {{package: lab, executable: {name}, node: /{name}}}}}")
    deployment = folder / "deployment.yaml"
    deployment.write_text("\n".join(lines))
    return deployment, {**os.environ, "AMENT_PREFIX_PATH": f"{folder}:{os.environ['AMENT_PREFIX_PATH']}"}


def test_nets_that_deadlock_together_are_not_started(tmp_path):
    docs = Path(__file__).resolve().parent.parent / "docs" / "nets"
    nets = {name: (docs / f"circular_wait_{name}.yaml").read_text() for name in ("arm", "camera")}
    deployment, environment = lab(tmp_path, nets)
    command = [sys.executable, "-m", "im_bringup.machine.start", str(deployment), "--unproved", "--timeout", "200"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1
    refusal = "nets circular_wait_arm, circular_wait_camera are refused:"
    assert f"start: its nets may not run together:\n  {refusal}\n" in done.stderr
    assert "it is stuck with circular_wait_arm.asked=1" in done.stderr
    assert "after       circular_wait_arm.move.start -> circular_wait_camera.arrive.I.look" in done.stderr
    assert "start: start" not in done.stdout
    assert leftovers.processes() == []
    assert machine.read() is None
