"""Data objects of commands in several nodes: two commands at once do not meet, and what they leave is forgotten."""

import shutil

import pytest
import rclpy
from std_msgs.msg import String

from im_core.names import run_dir
from im_core.ros.run import spin_in_thread
from im_dom.ros.node import DomNode, to_info
from im_msgs.msg import ObjectChange
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

BOSS = """
net: boss
places: {idle: 2, wanted: {data_object: goal}, planned: {data_object: path}, met: , bad: }
transitions:
  want: {symbol: go, in: idle, out: wanted, action: want, on_failure: bad}
  plan: {in: wanted, out: planned, request: planner.plan, on_failure: bad}
  move: {in: planned, out: met, request: mover.move, on_failure: bad, guard: both}
  done: {in: met, out: idle, emit: go_done}
  failed: {in: bad, out: idle, emit: go_failed}
"""
PLANNER = """
net: planner
places: {asked: , planned: {data_object: path}, refused: }
services: {plan: {entry: asked, done: planned, failed: refused}}
transitions: {plan: {in: asked, out: planned, action: plan, on_failure: refused}}
"""
MOVER = """
net: mover
places: {asked: , moved: {data_object: {name: last_move, scope: global}}, refused: }
services: {move: {entry: asked, done: moved, failed: refused}}
transitions: {move: {in: asked, out: moved, action: move, on_failure: refused}}
"""
WATCHER = """
net: watcher
places:
  there: {tokens: 1, data_object: {name: notes, scope: global}, on_invalid: [gone]}
  gone:
  moved:
  used:
transitions:
  use: {in: there, out: used}
  again: {in: used, out: there, guard: never}
  mourn: {in: gone, out: moved}
  back: {in: moved, out: there, guard: never}
"""
KEEPER = """
net: keeper
places:
  there: {tokens: 1, data_object: {name: notes, scope: global}, on_invalid: [gone]}
  gone:
  moved:
transitions:
  mourn: {in: gone, out: moved}
  leave: {in: there, out: moved, guard: never}
  back: {in: moved, out: there, guard: never}
"""
MOVED_IN = """
net: moved_in
places:
  before: {tokens: 1}
  there: {data_object: {name: letters, scope: global}, on_invalid: [gone]}
  gone:
transitions:
  move: {in: before, out: there}
  leave: {in: there, out: before, guard: never}
  back: {in: gone, out: before, guard: never}
"""
LEFT_BEHIND = ("boss/20200131-142501-7/goal", "boss/20200131-142501-70/goal")
KEPT = ("last_move", "boss/notes", "bosses/20200131-142501-7/goal")


class Cast:
    """A node that takes commands, two coordinators that work for it, and the Data Object Manager."""

    def __init__(self, folder) -> None:
        for net, text in (
            ("boss", BOSS),
            ("planner", PLANNER),
            ("mover", MOVER),
            ("watcher", WATCHER),
            ("keeper", KEEPER),
            ("moved_in", MOVED_IN),
        ):
            (folder / f"{net}.yaml").write_text(text)
        self.folder = folder
        self.planned, self.moved, self.named, self.ended = [], {}, set(), {}
        self.dom = DomNode()
        self.planner = self.node("planner", {"plan": self.plan})
        self.mover = self.node("mover", {"move": self.move})

    def node(self, name, functions, guards=None):
        return PntNode(name, [self.folder / f"{name}.yaml"], functions, guards, verifier=verify_to_load)

    def boss_node(self):
        return self.node("boss", {"want": self.want}, {"both": lambda ctx: len(self.planned) > 1})

    async def want(self, ctx) -> None:
        await self.boss.dom.put(ctx.object("goal"), String(data=ctx.command.arguments["goal"]))

    async def plan(self, ctx) -> None:
        goal = await self.planner.dom.get(ctx.object("goal"), String)
        await self.planner.dom.put(ctx.object("path"), String(data=f"to {goal.data}"))
        self.planned.append(goal.data)

    async def move(self, ctx) -> None:
        path = await self.mover.dom.get(ctx.object("path"), String)
        self.moved[ctx.command.arguments["goal"]] = path.data
        self.named.add(ctx.object("path"))
        await self.mover.dom.put(ctx.object("last_move"), path)

    def command(self, goal) -> None:
        async def work():
            self.ended[goal] = await self.boss.commands.run("go", {"goal": goal})

        self.boss.spawn(work())

    def put(self, name) -> None:
        in_loop(self.dom, self.dom.store.put, name, "std_msgs/msg/String", b"", "", "test", 0)

    def objects(self) -> list[str]:
        return [record.name for record in in_loop(self.dom, self.dom.store.records)]


@pytest.fixture(scope="module")
def cast(tmp_path_factory):
    rclpy.init(args=["--ros-args", "-p", "standalone:=true"])
    cast = Cast(tmp_path_factory.mktemp("nets"))
    with spin_in_thread(cast.dom, cast.planner, cast.mover):
        yield cast
    rclpy.try_shutdown()


def test_two_commands_at_once_have_objects_of_their_own_in_all_nodes_and_leave_none(cast, wait_until):
    """They are forgotten also where the node has died: those of commands that are not under way when it begins."""
    wait_until(lambda: cast.dom.ready, "the Data Object Manager")
    for name in (*LEFT_BEHIND, *KEPT):
        cast.put(name)
    cast.boss = cast.boss_node()
    with spin_in_thread(cast.boss):
        wait_until(lambda: set(cast.objects()) == set(KEPT), "what former lives have left to be forgotten")
        for goal in ("a", "b"):
            cast.command(goal)
        wait_until(lambda: len(cast.ended) == 2, "the commands")
        assert [(goal, outcome.success) for goal, outcome in sorted(cast.ended.items())] == [("a", True), ("b", True)]
        assert cast.moved == {"a": "to a", "b": "to b"}
        assert len(cast.named) == 2
        wait_until(lambda: set(cast.objects()) == set(KEPT), "what the commands have left to be forgotten")
        assert in_loop(cast.dom, cast.dom.store.record, "last_move").valid


@pytest.mark.parametrize(("valid", "marked"), [(True, "used"), (False, "moved")])
def test_a_node_that_begins_looks_whether_what_its_places_stand_for_is_still_valid(cast, wait_until, valid, marked):
    """It may have lost its validity while the node was dead; no transition takes the token before that is known."""
    wait_until(lambda: cast.dom.ready, "the Data Object Manager")
    cast.put("notes")
    if not valid:
        in_loop(cast.dom, cast.dom.store.invalidate, "notes", "test", 0)
    watcher = cast.node("watcher", {}, {"never": lambda ctx: False})
    with spin_in_thread(watcher):
        wait_until(lambda: "watcher" in watcher.exchange.nets, "the net")
        wait_until(lambda: watcher.exchange.nets["watcher"].marking() == {marked: 1}, "the token to move")


def test_when_dom_has_died_tokens_follow_what_has_become_of_its_objects(cast, wait_until):
    """What /dom told of its last changes before it died may have reached nobody, as here."""
    wait_until(lambda: cast.dom.ready, "the Data Object Manager")
    cast.put("notes")
    keeper = cast.node("keeper", {}, {"never": lambda ctx: False})
    with spin_in_thread(keeper):
        wait_until(lambda: keeper.heartbeats.incarnation("dom") == cast.dom.incarnation, "the heartbeat of /dom")
        wait_until(lambda: keeper.begun, "the node to have looked at the objects")
        assert keeper.exchange.nets["keeper"].marking() == {"there": 1}
        in_loop(cast.dom, cast.dom.store.invalidate, "notes", "test", 0)
        cast.dom.incarnation += 1
        wait_until(lambda: keeper.exchange.nets["keeper"].marking() == {"moved": 1}, "the token to move")


def test_what_was_put_for_a_place_of_a_net_is_not_valid_when_that_has_gone(cast, wait_until, tmp_path, monkeypatch):
    """Whoever comes later is told, too: /dom, as it was dead meanwhile."""
    wait_until(lambda: cast.dom.ready, "the Data Object Manager")
    for name in ("notes", "diary"):
        cast.put(name)
    node = cast.node("keeper", {}, {"never": lambda ctx: False})
    told = cast.planner._library._unread
    with spin_in_thread(node):
        wait_until(lambda: node.begun and ("keeper", "/keeper") in told, "the net to be described")
        node.spawn(node.dom.put("notes", String(), "keeper.there"))
        wait_until(lambda: in_loop(cast.dom, cast.dom.store.record, "notes").place, "the object")
        node.spawn(node.loader.unload("keeper"))
        wait_until(lambda: not in_loop(cast.dom, cast.dom.store.record, "notes").valid, "the object to be invalid")
        assert in_loop(cast.dom, cast.dom.store.record, "diary").valid
        wait_until(lambda: ("keeper", "/keeper") not in told, "other nodes to reckon with it no more")
        in_loop(cast.dom, cast.dom.store.put, "notes", "std_msgs/msg/String", b"", "keeper.there", "test", 0)
        for file in run_dir().glob("dom.sqlite*"):
            shutil.copy(file, tmp_path)
        monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))  # two never keep one store
        late = DomNode()
        with spin_in_thread(late):
            wait_until(lambda: late.ready, "another /dom")
            wait_until(lambda: not in_loop(late, late.store.record, "notes").valid, "the object to be invalid there")


def test_a_token_that_no_action_has_brought_goes_when_its_object_is_not_valid(cast, wait_until):
    wait_until(lambda: cast.dom.ready, "the Data Object Manager")
    node = cast.node("moved_in", {}, {"never": lambda ctx: False})
    with spin_in_thread(node):
        wait_until(lambda: node.begun, "the node to have looked at the objects")
        wait_until(lambda: node.exchange.nets["moved_in"].marking() == {"gone": 1}, "the token to move")


def test_a_token_stays_when_its_object_was_put_again_before_the_change_is_heard(cast, wait_until, monkeypatch):
    """The answer to a put may overtake what is told of the invalidation before it."""
    wait_until(lambda: cast.dom.ready, "the Data Object Manager")
    cast.put("notes")
    keeper = cast.node("keeper", {}, {"never": lambda ctx: False})
    settled = []
    with spin_in_thread(keeper):
        wait_until(lambda: keeper.begun, "the node to have looked at the objects")
        settle = keeper._validity._settle
        monkeypatch.setattr(keeper._validity, "_settle", lambda *what: (settle(*what), settled.append(what)))
        record = in_loop(cast.dom, cast.dom.store.invalidate, "notes", "test", 0)
        cast.put("notes")
        late = ObjectChange(object=to_info(record))
        in_loop(keeper, keeper._validity._hear, late)
        wait_until(lambda: ("notes", True) in settled, "the object to be looked at")
        wait_until(lambda: not keeper.exchange.nets["keeper"].due, "the net to be at rest")
        assert keeper.exchange.nets["keeper"].marking() == {"there": 1}
