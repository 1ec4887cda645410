"""What a client of the Data Object Manager asks for, and what it knows already."""

import pytest
import rclpy
from std_msgs.msg import Int32, String

from im_core import clock
from im_core.errors import ImError
from im_core.ros import qos
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_dom.ros.node import DomNode
from im_msgs.msg import ObjectChange


class CountingDom(DomNode):
    """Counts what it is asked."""

    def __init__(self) -> None:
        self.calls = 0
        super().__init__()

    def _put(self, request, response):
        self.calls += 1
        return super()._put(request, response)

    def _get(self, request, response):
        self.calls += 1
        return super()._get(request, response)


class Client(ManagedNode):
    """A node with a client, and a thread outside that has it work."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.dom, self.changes = DomClient(self), []
        self.create_subscription(ObjectChange, "/dom/changes", self._changed, qos.EVENTS)

    def _changed(self, change) -> None:
        self.dom.heard(change.object)
        self.changes.append((change.object.name, change.object.version, change.object.valid))

    def do(self, work):
        done = []

        async def run():
            try:
                done.append((await work, None))
            except ImError as error:
                done.append((None, error))

        self.spawn(run())
        for _ in range(1000):
            if done:
                break
            clock.sleep(0.01)
        (result, error) = done[0]
        if error is not None:
            raise error
        return result


@pytest.fixture
def three(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    rclpy.init(args=["--ros-args", "-p", "standalone:=true"])
    dom, mine, other = CountingDom(), Client("mine"), Client("other")
    with spin_in_thread(dom, mine, other):
        yield dom, mine, other
    rclpy.try_shutdown()


def test_what_a_node_has_put_costs_no_further_call_until_somebody_changes_it(three, wait_until):
    dom, mine, other = three
    assert mine.do(mine.dom.put("a", String(data="one"))) == 1
    for node in (mine, other):
        wait_until(lambda: ("a", 1, True) in node.changes, "the change")  # noqa: B023
    calls = dom.calls
    assert mine.do(mine.dom.get("a", String)).data == "one"
    assert mine.do(mine.dom.is_valid("a"))
    assert other.do(other.dom.is_valid("a"))
    assert dom.calls == calls
    assert other.do(other.dom.get("a", String)).data == "one"
    assert dom.calls == calls + 1
    with pytest.raises(ImError, match="is a std_msgs/msg/String, not a std_msgs/msg/Int32"):
        mine.do(mine.dom.get("a", Int32))

    assert other.do(other.dom.put("a", String(data="two"))) == 2
    wait_until(lambda: ("a", 2, True) in mine.changes, "the change")
    assert mine.do(mine.dom.get("a", String)).data == "two"

    other.do(other.dom.invalidate("a"))
    wait_until(lambda: ("a", 2, False) in mine.changes, "the change")
    assert not mine.do(mine.dom.is_valid("a"))
    with pytest.raises(ImError, match="is not valid; other invalidated it"):
        mine.do(mine.dom.get("a", String))
    assert mine.do(mine.dom.put("a", String(data="three"))) == 3
    assert mine.do(mine.dom.get("a", String)).data == "three"


def test_a_change_that_arrives_late_is_no_news(three):
    dom, mine, _ = three
    for text in ("one", "two"):
        mine.do(mine.dom.put("b", String(data=text)))
    calls = dom.calls
    late = ObjectChange()
    late.object.name, late.object.version, late.object.valid = "b", 1, False
    mine.dom.heard(late.object)
    assert mine.do(mine.dom.is_valid("b"))
    assert mine.do(mine.dom.get("b", String)).data == "two"
    assert dom.calls == calls
