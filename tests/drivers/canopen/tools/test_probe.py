"""The probe of a bus on simulated boards."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.tools.probe import ProbedNode, probe_bus
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.canopen.wire.events import FrameReceived
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, each_node, two_boards
from tests.drivers.sessions import SessionInWorld


def probed(world: World, **options: bool) -> list[ProbedNode]:
    with SessionInWorld(world) as asking:
        world.frames(sdo=True)
        return probe_bus(asking, "can0", **options)


def test_all_nodes_are_found_and_nothing_is_written() -> None:
    world = World(two_boards())
    five, nine = probed(world)
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


@pytest.mark.parametrize("name", ["many-outputs", "maker-object", "canopennode", "short-mapping"])
def test_each_variant_has_its_row(name: str) -> None:
    world = World(two_boards(), variant=name)
    world.run(6.0)
    five = probed(world)[0]
    assert (five.node, five.answers, five.trouble) == (5, True, None)
    board = world.board().objects
    for (index, sub), value in five.numbers.items():
        assert value == board.number(index, sub), f"{index:04X}h sub {sub}"
    assert [pdo.parameters for pdo in five.rpdos] == [i for i in range(0x1400, 0x1420) if board.has(i)]


def test_a_probe_takes_no_longer_with_many_silent_nodes() -> None:
    world = World(each_node(100))
    for node in range(2, 101):
        world.fault("silence", f"can0/{node}")
    begun_at = world.now
    assert [node.node for node in probed(world)] == [1]
    assert world.now - begun_at < 4.0


def test_a_stopped_board_is_heard_though_it_does_not_answer() -> None:
    world = World(two_boards()).up()
    world.nmt(cia301.Command.STOP, 9)
    world.run(0.1)
    assert [(node.node, node.answers, node.state) for node in probed(world)] == [
        (5, True, State.PRE_OPERATIONAL),
        (9, False, State.STOPPED),
    ]


def test_a_stopped_board_without_heartbeats_answers_a_remote_frame() -> None:
    world = World(two_boards(), variants={"can0/9": VARIANTS["guarding-only"]})
    world.nmt(cia301.Command.STOP, 9)
    assert [(node.node, node.answers, node.state) for node in probed(world)] == [
        (5, True, None),
        (9, False, State.STOPPED),
    ]
    polled = [frame.id & 0x7F for frame in world.buses["can0"].log if frame.id & cia301.REMOTE]
    assert 5 not in polled, "a remote frame starts the node guarding of a board that answers"


def test_a_board_with_the_factory_default_127_is_no_master() -> None:
    world = World()
    with SessionInWorld(world) as asking:
        world.say(cia301.HEARTBEAT + 0x7F, b"\x7f")
        found = probe_bus(asking, "can0")
    assert [(node.node, node.state) for node in found if not node.answers] == [(0x7F, State.PRE_OPERATIONAL)]


def test_a_short_probe_reads_the_identity_only() -> None:
    [five] = probed(World(), in_full=False)
    assert {index for index, _ in five.numbers} == {0x1000, 0x1018}


def test_a_node_that_stops_answering_is_reported() -> None:
    world = World()
    board = world.board()

    def fail_after(bus: str, frame: Frame) -> bool:
        board.silent |= frame.id == 0x585 and frame.data[1:3] == bytes.fromhex("05 10")
        return False

    world.lost = fail_after
    assert "it stopped answering at" in probed(world)[0].trouble


def test_a_bus_that_is_down_ends_the_probe() -> None:
    with SessionInWorld(World()) as asking:
        asking.lose("can0")
        with pytest.raises(BusError, match="can0: it is down"):
            probe_bus(asking, "can0")


def test_strange_frames_do_no_harm() -> None:
    world = World()
    with SessionInWorld(world) as asking:
        for frame in (Frame(0x585, b"\x43"), Frame(0x585, b"\xff" * 8), Frame(0x705, b""), Frame(0x7FF, b"\x09")):
            asking.buses["can0"].events.append(FrameReceived("can0", frame))
        [five] = probe_bus(asking, "can0")
    assert (five.node, five.answers) == (5, True)
