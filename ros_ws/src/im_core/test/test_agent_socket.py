import os
import subprocess
import sys

from im_core.processes import agent_socket
from im_core.processes.agent_socket import AgentOrder, AgentSocket, TaskIncarnation, TaskReport

CHILD = """
from im_core.processes.agent_socket import AgentSocket, TaskReport
agent = AgentSocket.inherited()
assert AgentSocket.inherited() is None
agent.report(TaskReport("oven", 2**63 - 1, 4, "it is cold: \u00e9" + "x" * 30_000))
for order in agent.orders():
    print(order.phase, order.incarnations["oven"].incarnation, flush=True)
print("the agent is gone", flush=True)
"""


def test_orders_go_to_a_process_and_its_reports_come_back():
    ours, theirs = AgentSocket.pair()
    environment = {**os.environ, agent_socket.VARIABLE: str(theirs), "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", CHILD]
    with subprocess.Popen(command, pass_fds=[theirs], env=environment, stdout=subprocess.PIPE, text=True) as child:
        os.close(theirs)
        assert ours.send(AgentOrder(1, {"oven": TaskIncarnation(5, 0, True)}).text())
        assert child.stdout.readline() == "1 5\n"
        (report,) = ours.reports()
        assert (report.task, report.incarnation, report.phase) == ("oven", 2**63 - 1, 4)
        assert report.detail.startswith("it is cold: \u00e9xxx")
        assert list(ours.reports()) == []
        ours.close()
        assert child.stdout.read() == "the agent is gone\n"
    assert child.returncode == 0


def test_neither_end_waits_for_the_other():
    ours, descriptor = AgentSocket.pair()
    theirs = AgentSocket.of(descriptor)
    text = AgentOrder(2, {f"task{number}": TaskIncarnation(number, 0, False) for number in range(100)}).text()
    while ours.send(text):
        pass
    for number in range(20_000):
        theirs.report(TaskReport("oven", 1, 2, str(number)))
    told = [report.detail for report in ours.reports()]
    assert told == [str(number) for number in range(len(told))]
    assert 0 < len(told) < 20_000
    theirs.close()
    assert not ours.send(text)
    assert list(ours.reports()) == []
