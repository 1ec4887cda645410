"""What a command has established goes with the life of who keeps it, also where a coordinator has just begun."""

import asyncio

import pytest

from im_coordinators.ros import establishment
from im_coordinators.ros.establishment import Establishment
from im_core.errors import StateError, WaitTimeoutError


class Objects(dict):
    """The objects of a DOM."""

    async def put(self, name, message):
        self[name] = message

    async def get(self, name, message_type):
        return self[name]

    async def is_valid(self, name):
        return name in self


class Coordinator:
    """One that hears the tasks with the given lives, the next one after each pause."""

    def __init__(self, *lives):
        self.dom, self._lives = Objects(), list(lives)

    def life(self, task):
        return self._lives[0]

    async def pause(self, seconds):
        if len(self._lives) > 1:
            self._lives.pop(0)


class Command:
    """The context of an action of a command."""

    def object(self, name):
        return f"1/{name}"


@pytest.mark.parametrize("heard", [(5,), (None, None, 5)], ids=["known", "just begun"])
def test_another_life_is_noticed_whenever_the_coordinator_began(heard):
    host = Coordinator(*heard, 6)
    powered = Establishment(host, "mcs", "powered")

    async def mission():
        await powered.note(Command(), "left")
        await powered.require(Command(), "left")
        await host.pause(1.0)
        with pytest.raises(StateError, match="mcs has begun anew since left was powered") as raised:
            await powered.require(Command(), "left")
        assert raised.value.code == "begun_anew"

    asyncio.run(mission())


def test_nothing_is_established_at_one_who_is_not_heard(monkeypatch):
    monkeypatch.setattr(establishment, "HEARD_S", 0.0)
    host = Coordinator(None)
    with pytest.raises(WaitTimeoutError, match="the heartbeat of mcs"):
        asyncio.run(Establishment(host, "mcs", "powered").note(Command(), "left"))
    assert not host.dom
