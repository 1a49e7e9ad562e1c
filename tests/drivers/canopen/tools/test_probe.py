"""The board probe on simulated boards."""

from __future__ import annotations

import pytest

from drivers.canopen.faults import BusError
from drivers.canopen.tools.probe import Answer, Probe, probe
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import Changed, Echoed, Received
from drivers.canopen.wiring import BusSettings, Channel, Timing, Wiring
from tests.drivers.canopen.world import World, two_boards, two_buses


class Asking:
    """Takes the place of the master in a world."""

    def __init__(self, world: World) -> None:
        self.outbox: list[tuple[str, Frame]] = world._outbox
        self.probe = Probe(world.wiring, world.timing, lambda bus, frame: self.outbox.append((bus, frame)))

    def receive(self, bus, frame, now):
        self.probe.take(Received(bus, frame), now)

    def echoed(self, bus, frame, now):
        self.probe.take(Echoed(bus, frame), now)

    def send_failed(self, bus, frame, why, now):
        self.probe.send_failed(bus, frame, now)

    def tick(self, now):
        self.probe.tick(now)

    def take_faults(self):
        return []

    take_switched = take_faults


def asked(world: World, lose: str | None = None, patience: float = 20.0) -> tuple[Answer, ...]:
    world.run(0.05)
    world.master = asking = Asking(world)
    world.frames()
    asking.probe.start(world.now)
    world.flush()
    if lose:
        asking.probe.take(Changed(lose, "down", "it is down", None), world.now)
    world.until(lambda: asking.probe.answers is not None, patience)
    return asking.probe.answers


def test_every_board_says_what_it_is_and_nothing_on_it_changes():
    world = World(two_boards())
    world.boards["can0", 9].objects.put(0x1000, 0, 0x00020191)
    fresh = World(two_boards()).boards["can0", 5].objects
    good, other = asked(world)
    assert (good.board, good.ok) == ("can0/5", True)
    assert good.text.startswith("device type 00030191h, error register 00h; to be written: 1016h sub 1 (heartbeat of")
    assert (other.board, other.ok) == ("can0/9", True)
    assert "1000h sub 0 is 00020191h, without the bit of digital inputs" in other.text
    held = world.boards["can0", 5].objects
    assert all(held.number(*place) == fresh.number(*place) for place in held._values)
    assert not any(cob_id < 0x580 for cob_id, _ in world.frames())


def test_an_error_register_is_told():
    world = World()
    world.boards["can0", 5].objects.put(0x1001, 0, 0x81)
    [answer] = asked(world)
    assert not answer.ok
    assert "error register 1001h sub 0 is 81h; 00h is needed" in answer.text


def test_silent_boards_are_asked_in_parallel():
    world = World([Channel(str(n), "can0", n, 0, 0) for n in range(1, 101)])
    for board in world.boards.values():
        board.silent = True
    answers = asked(world)
    assert not any(answer.ok for answer in answers)
    assert "can0/1 neither booted nor answered" in answers[0].text
    assert world.now < 2


def test_boards_of_a_lost_bus_do_not_answer():
    good, lost = asked(World(two_buses()), lose="can1")
    assert (good.ok, lost.ok) == (True, False)
    assert "can1/5 does not answer: can1: it is down" in lost.text


def test_a_bus_that_cannot_be_opened_is_told():
    bus = BusSettings("can0", "socketcan", "no-such-interface")
    with pytest.raises(BusError, match="no-such-interface"):
        probe(Wiring((bus,), (Channel("a", "can0", 5, 0, 0),)), Timing())


def test_an_empty_bus():
    bus = BusSettings("can0", "virtual", "test_probe")
    [answer] = probe(Wiring((bus,), (Channel("a", "can0", 5, 0, 0),)), Timing())
    assert "can0/5 neither booted nor answered" in answer.text
