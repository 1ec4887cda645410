"""What a client of the Data Object Manager asks for, and what it knows already."""

import json
from array import array
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import Byte, ByteMultiArray, Int32, String, UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_core import clock
from im_core.errors import DataError, ImError, StoreError, WaitTimeoutError
from im_core.files import LARGEST
from im_core.ros import dom as dom_client
from im_core.ros import qos
from im_core.ros.calls import call
from im_core.ros.dom import DomClient
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_dom.ros.node import DomNode
from im_dom.store import ObjectStore
from im_msgs.msg import NetDescription, ObjectChange
from im_msgs.srv import AppendObject, GetObject, ListObjects, PutObject


class CountingDom(DomNode):
    """Counts what it is asked."""

    def __init__(self) -> None:
        self.calls = 0
        super().__init__()

    def create_service(self, kind, name, callback, **options):
        def counted(request, response):
            self.calls += 1
            return callback(request, response)

        counts = name in ("/dom/put", "/dom/get")
        return super().create_service(kind, name, counted if counts else callback, **options)


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
        deadline = clock.monotonic() + 60.0
        while not done and clock.monotonic() < deadline:
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


def test_an_answer_that_a_change_has_overtaken_is_no_news(three, monkeypatch):
    """Answers and changes come on topics of their own: that an object was valid may be heard after that it is not."""
    _, mine, other = three
    other.do(other.dom.put("b", String(data="one")))
    call_dom = mine.dom._call

    async def overtaken(*arguments):
        answer = await call_dom(*arguments)
        change = ObjectChange()
        change.object.name, change.object.version, change.object.valid = "b", 1, False
        mine.dom.heard(change.object)
        return answer

    mine.dom.forget_known()
    monkeypatch.setattr(mine.dom, "_call", overtaken)
    assert not mine.do(mine.dom.is_valid("b"))


def test_what_is_below_a_name_is_forgotten_and_told_of(three, wait_until):
    _, mine, other = three
    for name in ("boss/1/a", "boss/1/b", "boss/12/a"):
        mine.do(mine.dom.put(name, String(data=name)))
    wait_until(lambda: ("boss/12/a", 1, True) in mine.changes, "the changes")
    assert other.do(other.dom.names("boss/")) == ["boss/1/a", "boss/1/b", "boss/12/a"]
    other.do(other.dom.forget("boss/1/"))
    for name in ("boss/1/a", "boss/1/b"):
        wait_until(lambda: (name, 1, False) in mine.changes, "the change")  # noqa: B023
        with pytest.raises(ImError, match=f"there is no data object '{name}'"):
            mine.do(mine.dom.get(name, String))
    assert mine.do(mine.dom.names("boss/")) == ["boss/12/a"]


def test_a_client_remembers_no_more_than_it_can(three, monkeypatch, wait_until):
    monkeypatch.setattr("im_core.ros.dom.MOST_KNOWN", 2)
    dom, mine, _ = three
    for name in ("a", "b", "c"):
        mine.do(mine.dom.put(name, String(data=name)))
        wait_until(lambda: (name, 1, True) in mine.changes, "the change")  # noqa: B023 - later it would be news
    calls = dom.calls
    assert [mine.do(mine.dom.get(name, String)).data for name in ("c", "b", "a")] == ["c", "b", "a"]
    assert dom.calls == calls + 1


def ask(node, client, request):
    """The answer of a service of /dom to a request as anybody may make it."""
    return node.do(call(node, client, request, 60.0, "to be answered"))


GARBLED = {
    "nothing": (b"", "'a' is no std_msgs/msg/String: its 0 bytes do not decode"),
    "no CDR": (b"\0\1\0\0\xff\xff\xff\x7fabc", "its 11 bytes do not decode"),
    "another type": (serialize_message(PoseStamped()), "bytes follow after the end of one"),
}


@pytest.mark.parametrize("kind", GARBLED)
def test_bytes_that_are_no_message_of_the_type_are_refused(three, kind):
    _, mine, _ = three
    data, sentence = GARBLED[kind]
    request = PutObject.Request(name="a", type="std_msgs/msg/String", data=data)
    answer = ask(mine, mine.dom._put, request)
    assert (answer.success, answer.status.code) == (False, "data")
    assert sentence in answer.status.message
    assert mine.do(mine.dom.names("")) == []


def test_a_type_that_is_not_installed_is_refused(three):
    _, mine, _ = three
    for kind, sentence in (
        ("std_msgs/msg/Strin", "did you mean 'String'"),
        ("no_such/msg/Type", "no_such"),
        ("unittest/__main__/X", "unittest"),  # to import that would end the thread that does
        ("unittest/msg/X", "unittest"),
    ):
        answer = ask(mine, mine.dom._put, PutObject.Request(name="a", type=kind, data=b"\0\1\0\0"))
        assert (answer.success, answer.status.code) == (False, "not_found")
        assert sentence in answer.status.message


@pytest.mark.parametrize("kind", ["std_srvs/srv/SetBool", "im_msgs/action/ExecuteCommand"])
@pytest.mark.parametrize("told", [{"data": b"\0\1\0\0\0"}, {"json": "{}"}])
def test_a_type_of_a_service_or_an_action_is_refused(three, kind, told):
    _, mine, _ = three
    mine.do(mine.dom.put("a", String()))
    for client, request in ((mine.dom._put, PutObject.Request), (mine.dom._append, AppendObject.Request)):
        answer = ask(mine, client, request(name="a", type=kind, **told))
        assert (answer.success, answer.status.code) == (False, "data")
        assert f"{kind} is no type of messages, but that of a service or an action" in answer.status.message


def test_an_object_tells_its_type_where_it_comes_from_and_what_it_holds(three):
    _, mine, other = three
    name = "boss/20260131-142501-7/goal"
    mine.do(mine.dom.put(name, PoseStamped(), place=""))
    found = ask(other, other.dom._get, GetObject.Request(name=name, as_json=True))
    assert (found.object.source, found.object.command) == ("mine", "boss/20260131-142501-7")
    assert found.object.type_hash == "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
    assert json.loads(found.json)["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert len(found.data) == 0


def test_older_versions_are_read_and_the_newest_is_what_is_meant(three):
    _, mine, other = three
    for text in ("one", "two"):
        mine.do(mine.dom.put("a", String(data=text)))
    assert other.do(other.dom.version("a", String, 1)).data == "one"
    assert other.do(other.dom.get("a", String)).data == "two"
    with pytest.raises(ImError, match="there is no version of data object 'a' '3'"):
        other.do(other.dom.version("a", String, 3))


def test_an_object_grows_by_the_sequences_of_a_message_of_its_type(three, wait_until):
    _, mine, other = three
    begun = JointTrajectory(joint_names=["a"], points=[JointTrajectoryPoint(positions=[1.0])])
    begun.header.frame_id = "world"
    mine.do(mine.dom.put("path", begun))
    further = JointTrajectory(points=[JointTrajectoryPoint(positions=[value]) for value in (2.0, 3.0)])
    assert other.do(other.dom.append("path", further)) == 2
    wait_until(lambda: ("path", 2, True) in mine.changes, "the change")
    found = mine.do(mine.dom.get("path", JointTrajectory))
    assert (found.header.frame_id, found.joint_names) == ("world", ["a"])
    assert [list(point.positions) for point in found.points] == [[1.0], [2.0], [3.0]]
    assert mine.do(mine.dom.version("path", JointTrajectory, 1)) == begun


def test_what_does_not_fit_is_not_appended(three):
    _, mine, _ = three
    mine.do(mine.dom.put("a", String(data="one")))
    with pytest.raises(ImError, match="'a' is a std_msgs/msg/String, which has no sequence to append to"):
        mine.do(mine.dom.append("a", String(data="two")))
    with pytest.raises(ImError, match="'a' is a std_msgs/msg/String, not a std_msgs/msg/UInt8MultiArray"):
        mine.do(mine.dom.append("a", UInt8MultiArray(data=b"two")))
    garbled = AppendObject.Request(name="a", type="std_msgs/msg/String", data=b"\0\1\0\0\xff\xff\xff\x7fabc")
    assert "do not decode" in ask(mine, mine.dom._append, garbled).status.message
    limited = SolidPrimitive(type=1, dimensions=[1.0, 2.0, 3.0])
    mine.do(mine.dom.put("box", limited))
    with pytest.raises(ImError, match="'box': dimensions would have 4 elements; at most 3 are allowed"):
        mine.do(mine.dom.append("box", SolidPrimitive(type=1, dimensions=[4.0])))
    assert mine.do(mine.dom.get("box", SolidPrimitive)) == limited


def test_an_append_whose_answer_was_lost_is_made_again_without_a_second_effect(three, monkeypatch):
    _, mine, _ = three
    mine.do(mine.dom.put("a", UInt8MultiArray(data=b"1")))
    call_once, answers = dom_client.call, []

    async def lost(node, client, request, *arguments):
        answer = await call_once(node, client, request, *arguments)
        answers.append(answer.object.version)
        if len(answers) == 1:
            raise WaitTimeoutError(what="an answer that was lost", seconds=0.0)
        return answer

    monkeypatch.setattr(dom_client, "call", lost)
    assert mine.do(mine.dom.append("a", UInt8MultiArray(data=b"2"))) == 2
    assert answers == [2, 2]
    monkeypatch.undo()
    assert bytes(mine.do(mine.dom.get("a", UInt8MultiArray)).data) == b"12"


def test_an_object_for_a_place_that_does_not_exist_is_refused(three, monkeypatch):
    _, mine, other = three
    monkeypatch.setattr("im_dom.ros.node.DESCRIBED_S", 0.2)
    with pytest.raises(ImError, match="there is no net 'cell'"):
        mine.do(mine.dom.put("a", String(), place="cell.there"))
    described = other.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
    described.publish(NetDescription(net="cell", node="/other", json='{"places": ["there"]}'))
    monkeypatch.setattr("im_dom.ros.node.DESCRIBED_S", 60.0)
    assert mine.do(mine.dom.put("a", String(), place="cell.there")) == 1
    monkeypatch.setattr("im_dom.ros.node.DESCRIBED_S", 0.2)
    with pytest.raises(ImError, match="there is no place of net cell 'ther'; did you mean 'there'"):
        mine.do(mine.dom.put("a", String(), place="cell.ther"))


def test_what_no_place_can_be_called_is_refused_without_waiting_for_its_net(three, monkeypatch):
    _, mine, _ = three
    monkeypatch.setattr("im_dom.ros.node.DESCRIBED_S", 3600.0)
    for place in ("cell", "cell.", "the cell.there"):
        with pytest.raises(ImError, match=f"the place of a data object '{place}' is not allowed: net.place"):
            mine.do(mine.dom.put("a", String(), place=place))


def test_an_object_whose_place_goes_while_the_disk_is_full_loses_its_validity_later(three, monkeypatch, wait_until):
    dom, mine, other = three
    described = other.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
    described.publish(NetDescription(net="cell", node="/other", json='{"places": ["there"]}'))
    monkeypatch.setattr("im_dom.ros.node.ABANDON_AGAIN_S", 0.1)
    mine.do(mine.dom.put("a", String(), place="cell.there"))
    abandon, full = dom.store.abandon, [True, True]

    def abandoned(*arguments):
        if full:
            full.pop()
            raise StoreError("no space left on device", file=Path("dom.sqlite"), reason="no space")
        return abandon(*arguments)

    monkeypatch.setattr(dom.store, "abandon", abandoned)
    described.publish(NetDescription(net="cell", node="/other", json='{"places": []}'))
    wait_until(lambda: ("a", 1, False) in mine.changes, "the change")
    assert not full


def net_told(by, at, places=None):
    """Has a node describe the net ``cell``, or say that it has gone; the publisher stays, as it is latched."""
    text = "" if places is None else json.dumps({"places": places})
    by.publish(NetDescription(net="cell", node=at, json=text))


def test_an_object_stays_valid_whose_net_another_node_has_taken_over(three, wait_until):
    _, mine, other = three
    former = mine.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
    present = other.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED)
    net_told(former, "/mine", ["there"])
    assert mine.do(mine.dom.put("a", String(), place="cell.there")) == 1
    net_told(present, "/other", ["there", "too"])
    assert mine.do(mine.dom.put("b", String(), place="cell.too")) == 1
    net_told(former, "/mine")
    former.publish(NetDescription(net="last", node="/mine", json='{"places": ["word"]}'))
    assert mine.do(mine.dom.put("c", String(), place="last.word")) == 1  # what was told before has been heard
    assert mine.do(mine.dom.put("a", String(), place="cell.there")) == 2
    assert not [change for change in mine.changes if not change[2]]
    net_told(present, "/other")
    wait_until(lambda: {("a", 2, False), ("b", 1, False)} <= set(mine.changes), "the end of the net")


def test_a_dom_that_hears_first_that_a_net_has_gone_waits_for_who_may_have_taken_it_over(
    three, monkeypatch, wait_until
):
    dom, mine, other = three
    wait_until(lambda: dom.ready, "the store")
    for name in ("cell.there", "gone.there"):  # objects of a former incarnation
        dom.store.put(name, "std_msgs/msg/String", b"", name, "other", 0)
    monkeypatch.setattr("im_dom.ros.node.DESCRIBED_S", 1.0)
    former = mine.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED_MANY)
    former.publish(NetDescription(net="gone", node="/mine"))
    net_told(former, "/mine")
    net_told(other.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED), "/other", ["there"])
    wait_until(lambda: ("gone.there", 1, False) in mine.changes, "the end of the net that nobody runs")
    assert dom.store.valid_record("cell.there").valid


def test_what_the_store_does_when_nobody_waits_for_it_any_more_is_told_all_the_same(three, monkeypatch, wait_until):
    dom, mine, _ = three
    wait_until(lambda: dom.ready, "the node")
    monkeypatch.setattr(dom._worker, "_timeout_s", 0.2)
    mine.do(mine.dom.put("a", String(data="one")))
    put = dom.store.put

    def slow(*arguments, **more):
        clock.sleep(0.5)
        return put(*arguments, **more)

    monkeypatch.setattr(dom.store, "put", slow)
    with pytest.raises(ImError, match="the objects' store of /dom to answer"):
        mine.do(mine.dom.put("a", String(data="two")))
    wait_until(lambda: ("a", 2, True) in mine.changes, "the change")
    assert mine.do(mine.dom.get("a", String)).data == "two"


@pytest.mark.parametrize("asked", ["validity", "names"])
def test_a_store_that_cannot_be_read_is_not_taken_for_one_without_the_object(three, monkeypatch, asked):
    dom, mine, _ = three
    reads, ask = {
        "validity": ("valid_record", lambda: mine.dom.is_valid("a/b")),
        "names": ("records", lambda: mine.dom.names("a/")),
    }[asked]
    assert not mine.do(ask())

    def unreadable(*arguments, **more):
        raise StoreError("the disk does not answer", file="dom.sqlite", reason="input/output error")

    with monkeypatch.context() as broken:
        broken.setattr(dom.store, reads, unreadable)
        with pytest.raises(ImError, match="the disk does not answer"):
            mine.do(ask())
    assert not mine.do(ask())


def test_an_object_that_is_damaged_is_named_to_all_who_look(tmp_path, monkeypatch, wait_until):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    store = ObjectStore(tmp_path / "dom.sqlite")
    for name in ("whole", "lost"):
        data = serialize_message(String(data=f"{name} {'-' * 100}"))
        store.put(name, "std_msgs/msg/String", data, "", "test", 1)
    store.close()
    content = (tmp_path / "dom.sqlite").read_bytes()
    (tmp_path / "dom.sqlite").write_bytes(content.replace(b"lost --", b"lost -+"))
    rclpy.init(args=["--ros-args", "-p", "standalone:=true"])
    try:
        dom, mine = DomNode(), Client("mine")
        heard, told = [], []
        mine.dom.damaged = told.append
        mine.create_subscription(DiagnosticArray, "/diagnostics", lambda array: heard.extend(array.status), qos.STATUS)
        with spin_in_thread(dom, mine):
            assert mine.do(mine.dom.get("whole", String)).data.startswith("whole")
            with pytest.raises(ImError, match=r"'lost' cannot be read: in the object store .*dom.sqlite the bytes of"):
                mine.do(mine.dom.get("lost", String))
            assert not mine.do(mine.dom.is_valid("lost"))
            assert len(told) == 2
            answer = ask(mine, mine.dom._list, ListObjects.Request())
            assert [info.name for info in answer.objects] == ["whole"]
            assert answer.status.message == told[0]
            found = wait_until(lambda: [each for each in heard if each.name == "dom: store"], "the diagnostics")[0]
            assert "has what is whole of it, 1 objects; damaged: lost" in found.values[0].value
            assert mine.do(mine.dom.put("lost", String(data="anew"))) == 2
            assert mine.do(mine.dom.get("lost", String)).data == "anew"
            # what comes about while the store is open is noticed where the bytes are read
            dom.store._cache.update({"whole": None})
            dom.store._db.execute("UPDATE versions SET data = zeroblob(length(data)) WHERE name = 'whole'")
            with pytest.raises(ImError, match="'whole' cannot be read"):
                mine.do(mine.dom.get("whole", String))
            wait_until(lambda: any("'whole'" in each.message for each in heard), "the diagnostics")
    finally:
        rclpy.try_shutdown()


def test_json_is_taken_as_it_is_given_out(three):
    _, mine, _ = three
    pose = PoseStamped()
    pose.header.frame_id, pose.pose.position.x, pose.pose.position.y = "world", 1.5, float("nan")
    mine.do(mine.dom.put("a", pose))
    found = ask(mine, mine.dom._get, GetObject.Request(name="a", as_json=True))
    kind = "geometry_msgs/msg/PoseStamped"
    assert ask(mine, mine.dom._put, PutObject.Request(name="b", type=kind, json=found.json)).success
    assert ask(mine, mine.dom._get, GetObject.Request(name="b", as_json=True)).json == found.json
    kind, fields = "trajectory_msgs/msg/JointTrajectory", '{"points": [{"positions": [1, 2]}]}'
    assert ask(mine, mine.dom._put, PutObject.Request(name="c", type=kind, json=fields)).success
    assert ask(mine, mine.dom._append, AppendObject.Request(name="c", type=kind, json=fields)).object.version == 2
    assert [list(point.positions) for point in mine.do(mine.dom.get("c", JointTrajectory)).points] == [[1, 2], [1, 2]]
    for name, message in (("d", Byte(data=b"\x05")), ("e", ByteMultiArray(data=[b"\x01", b"\xff"]))):
        mine.do(mine.dom.put(name, message))
        found = ask(mine, mine.dom._get, GetObject.Request(name=name, as_json=True))
        request = PutObject.Request(name=name, type=f"std_msgs/msg/{type(message).__name__}", json=found.json)
        assert ask(mine, mine.dom._put, request).object.version == 2
        assert mine.do(mine.dom.get(name, type(message))) == message


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ('{"dta": "x"}', "there is no field of std_msgs/msg/String 'dta'; did you mean 'data'"),
        ('{"data": 3}', "std_msgs/msg/String.data (string) cannot be 3"),
        ('{"data": ["x"]}', "std_msgs/msg/String.data (string) cannot be ['x']"),
        ('{"data": {"x": 1}}', "std_msgs/msg/String.data (string) cannot be {'x': 1}"),
        ('{"data": "a\\u0000b"}', "std_msgs/msg/String.data (string) cannot be 'a\\x00b'"),
        (f'{{"data": {[1] * 1000}}}', f"std_msgs/msg/String.data (string) cannot be {str([1] * 1000)[:80]}..."),
        ("[]", "the JSON of data object 'a'"),
    ],
)
def test_json_that_is_no_message_of_the_type_is_refused(three, fields, sentence):
    _, mine, _ = three
    answer = ask(mine, mine.dom._put, PutObject.Request(name="a", type="std_msgs/msg/String", json=fields))
    assert not answer.success
    assert sentence in answer.status.message
    assert len(answer.status.message) < 200


def test_json_with_a_number_in_the_place_of_a_message_is_refused(three):
    _, mine, _ = three
    request = PutObject.Request(name="a", type="geometry_msgs/msg/PoseArray", json='{"poses": [{}, 3]}')
    answer = ask(mine, mine.dom._put, request)
    assert not answer.success
    assert (
        answer.status.message == "geometry_msgs/msg/PoseArray.poses[1] cannot be 3: the fields of a message are needed"
    )


def test_who_waits_for_an_object_gets_it_when_it_is_put_and_else_hears_why_not(three):
    _, mine, other = three
    mine.do(mine.dom.put("a", String(data="old")))
    mine.do(mine.dom.invalidate("a"))
    got = []

    async def get(name):
        got.append((await other.dom.get(name, String, timeout_s=60.0)).data)

    for name in ("a", "b"):
        other.spawn(get(name))
        assert got == []
        mine.do(mine.dom.put(name, String(data=f"{name} is there")))
        for _ in range(6000):
            if got:
                break
            clock.sleep(0.01)
        assert got.pop() == f"{name} is there"
    mine.do(mine.dom.invalidate("a"))
    with pytest.raises(ImError, match=r"'a' .* is not valid; mine invalidated it"):
        other.do(other.dom.get("a", String, timeout_s=0.05))
    answer = ask(other, other.dom._get, GetObject.Request(name="a", timeout=float("nan")))
    assert "the time-out nan s is not allowed: 0 to 3600 s" in answer.status.message


def test_a_large_object_is_carried_and_one_that_is_too_large_refused_by_its_length(three):
    _, mine, other = three
    content = array("B", bytes(range(256)) * 2**15)  # 8 MiB: more than a message of the transport
    mine.do(mine.dom.put("large", UInt8MultiArray(data=content)))
    assert other.do(other.dom.get("large", UInt8MultiArray)).data == content
    with pytest.raises(DataError, match=r"'large' has \d+ bytes; at most 67108864 \(64 MiB\) are kept"):
        mine.do(mine.dom.put("large", UInt8MultiArray(data=array("B", bytes(LARGEST)))))


def test_of_many_requests_at_once_none_is_lost(three, monkeypatch):
    monkeypatch.setattr(dom_client, "TIMEOUT_S", 60.0)  # what is lost is not asked for again within the test
    _, mine, _ = three
    mine.do(mine.dom.put("a", String()))
    done = []

    async def put(number):
        done.append(await mine.dom.put(f"a/{number}", String(data=str(number))))

    for number in range(200):
        mine.spawn(put(number))
    deadline = clock.monotonic() + 60.0
    while len(done) < 200 and clock.monotonic() < deadline:
        clock.sleep(0.01)
    assert done == [1] * 200


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """A client without a /dom, and the module of its times."""
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(dom_client, "TIMEOUT_S", 0.1)
    rclpy.init(args=["--ros-args", "-p", "standalone:=true"])
    yield Client("mine")
    rclpy.try_shutdown()


def test_a_request_outlives_a_dom_that_hangs_and_is_started_again(alone):
    answers = []

    async def put():
        answers.append(await alone.dom.put("a", String(data="one")))

    with spin_in_thread(alone):
        alone.spawn(put())
        clock.sleep(0.5)  # several requests in vain
        assert not answers
        with spin_in_thread(DomNode()):
            deadline = clock.monotonic() + 60.0
            while not answers and clock.monotonic() < deadline:
                clock.sleep(0.01)
    assert answers == [1]


def test_of_a_dom_that_is_not_there_it_is_said_how_long_it_was_waited_for(alone, monkeypatch):
    monkeypatch.setattr(dom_client, "PATIENCE_S", 0.3)
    with spin_in_thread(alone), pytest.raises(WaitTimeoutError, match=r"waited 0\.3 s for /dom to store 'a', in vain"):
        alone.do(alone.dom.put("a", String(data="one")))
