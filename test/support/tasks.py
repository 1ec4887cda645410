"""A bootstrap of three tasks whose processes only stand for some."""

from im_bringup.machine.bootstrap import Bootstrap
from im_bringup.machine.nets import MachineNets
from im_bringup.tasks.agent import Agent, ProcessCommand
from im_bringup.tasks.deployment import PlacedTask, Task

NAMES = ("one", "two", "three")


def placed(names=NAMES, host="localhost"):
    return [
        PlacedTask(number, name, host, name, Task(package="p", executable="e", node=f"/{name}"))
        for number, name in enumerate(names, start=1)
    ]


class Process:
    """Stands for a process of the operating system."""

    pid = 7

    def __init__(self):
        self.code = None

    def poll(self):
        return self.code

    def send_signal(self, number):
        self.code = -number


def bootstrap(tmp_path, children=None, nets=None):
    children = {} if children is None else children

    def spawn(command, *_):
        children[command.name] = Process()
        return children[command.name]

    agent = Agent([ProcessCommand(name, (name,), ["x"], tmp_path / name) for name in NAMES], {}, spawn)
    nets = nets or MachineNets(tmp_path, unproved=False)
    value = Bootstrap(placed(), agent, "localhost", nets)
    value.start(0.0)
    return value
