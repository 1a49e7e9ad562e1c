"""The probe of a bus on simulated boards."""

from __future__ import annotations

import pytest

from drivers.canopen.faults import BusError
from drivers.canopen.tools.probe import Probe, ProbedNode, probe_bus
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import Frame, State
from drivers.canopen.wire.events import BusChanged, FrameReceived
from drivers.canopen.wiring import BusWiring, Channel
from drivers.simulation.variants import VARIANTS
from tests.drivers.canopen.world import World, two_boards


def begun(world: World, **options: bool) -> Probe:
    world.run(0.05)
    asking = Probe(world.wiring.buses[0], world.send, **options)
    world.use(asking)
    world.frames(sdo=True)
    asking.start(world.now)
    return asking


def probed(world: World, **options: bool) -> Probe:
    asking = begun(world, **options)
    world.until(lambda: asking.over, 300.0)
    return asking


def test_all_nodes_are_found_and_nothing_is_written() -> None:
    world = World(two_boards())
    asking = probed(world)
    assert asking.fault is None
    five, nine = asking.found
    assert (five.node, nine.node, five.answers, five.trouble) == (5, 9, True, None)
    assert five.numbers[0x1000, 0] == 0x00030191
    assert [five.numbers[0x1018, sub] for sub in range(5)] == [4, 0, 401, 1, 0]
    assert five.texts[0x1008]
    assert (five.numbers[0x6200, 0], five.numbers[0x6000, 0], five.numbers[0x1001, 0]) == (8, 8, 0)
    assert [(pdo.parameters, pdo.valid, pdo.entries) for pdo in five.rpdos] == [(0x1400, True, 8)]
    assert [(pdo.parameters, pdo.cob_id & 0x7FF) for pdo in nine.tpdos] == [(0x1800, 0x189)]
    requests = [data for cob_id, data in world.frames(sdo=True) if cob_id < 0x580 or 0x600 < cob_id < 0x680]
    assert requests
    assert all(data.startswith(("40", "60", "70")) for data in requests), "uploads and their segments only"


@pytest.mark.parametrize("name", VARIANTS)
def test_each_variant_has_its_row(name: str) -> None:
    world = World(two_boards(), variants={"can0/5": VARIANTS[name]})
    world.run(6.0)
    five = probed(world).found[0]
    assert (five.node, five.answers, five.trouble) == (5, True, None)
    board = world.boards.board("can0/5").objects
    for (index, sub), value in five.numbers.items():
        assert value == board.number(index, sub), f"{index:04X}h sub {sub}"
    assert [pdo.parameters for pdo in five.rpdos] == [i for i in range(0x1400, 0x1420) if board.has(i)]


def test_a_probe_takes_no_longer_with_many_silent_nodes() -> None:
    world = World([Channel(str(n), "can0", n, 0, 0) for n in range(1, 101)])
    for node in range(2, 101):
        world.fault("silence", f"can0/{node}")
    begun_at = world.now
    assert [node.node for node in probed(world).found] == [1]
    assert world.now - begun_at < 2.5


def test_a_stopped_board_is_heard_though_it_does_not_answer() -> None:
    world = World(two_boards()).up()
    world.say(cia301.NMT, bytes([cia301.Command.STOP, 9]))
    world.run(0.1)
    asking = probed(world)
    assert [(node.node, node.answers, node.state) for node in asking.found] == [
        (5, True, State.PRE_OPERATIONAL),
        (9, False, State.STOPPED),
    ]


def test_a_stopped_board_without_heartbeats_answers_a_remote_frame() -> None:
    world = World(two_boards(), variants={"can0/9": VARIANTS["guarding-only"]})
    world.say(cia301.NMT, bytes([cia301.Command.STOP, 9]))
    asking = probed(world)
    assert [(node.node, node.answers, node.state) for node in asking.found] == [
        (5, True, None),
        (9, False, State.STOPPED),
    ]
    polled = [frame.id & 0x7F for frame in world.buses["can0"].log if frame.id & cia301.REMOTE]
    assert 5 not in polled, "a remote frame starts the node guarding of a board that answers"


def test_a_boot_up_message_and_a_master_are_heard() -> None:
    world = World()
    asking = begun(world)
    world.say(cia301.HEARTBEAT + 0x40, b"\x00")
    world.say(cia301.HEARTBEAT + 0x7F, b"\x05")
    world.until(lambda: asking.over)
    assert [(node.node, node.state) for node in asking.found if not node.answers] == [
        (0x40, State.BOOT_UP),
        (0x7F, State.OPERATIONAL),
    ]
    assert asking.master_heard


def test_a_short_probe_reads_the_identity_only() -> None:
    [five] = probed(World(), in_full=False).found
    assert {index for index, _ in five.numbers} == {0x1000, 0x1018}


def test_a_node_that_stops_answering_is_reported() -> None:
    world = World()
    asking = begun(world)
    world.until(lambda: (0x1005, 0) in asking._nodes[5].numbers)
    world.boards.board("can0/5").silent = True
    world.until(lambda: asking.over, 60.0)
    assert "it stopped answering at" in asking.found[0].trouble


def test_a_bus_that_is_down_ends_the_probe() -> None:
    world = World()
    asking = begun(world)
    asking.receive_event(BusChanged("can0", "down", "it is down", None), world.now)
    assert (asking.over, asking.fault.message) == (True, "can0: it is down")


def test_strange_frames_do_no_harm() -> None:
    world = World()
    asking = begun(world)
    for frame in (Frame(0x585, b"\x43"), Frame(0x585, b"\xff" * 8), Frame(0x705, b""), Frame(0x7FF, b"\x09")):
        asking.receive_event(FrameReceived("can0", frame), world.now)
    world.until(lambda: asking.over, 60.0)
    assert asking.found[0] == ProbedNode(5, **{k: v for k, v in vars(asking.found[0]).items() if k != "node"})
    assert asking.found[0].answers


def test_an_empty_bus() -> None:
    assert probe_bus(BusWiring("can0", "virtual", "test_probe")).found == []
    with pytest.raises(BusError, match="no-such-interface"):
        probe_bus(BusWiring("can0", "socketcan", "no-such-interface"))
