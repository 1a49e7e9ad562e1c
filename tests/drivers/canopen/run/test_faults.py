"""Faults of boards and buses, and the reports of the master."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameEchoed, FrameIgnored
from hyperbit.drivers.canopen.wiring import Timing
from tests.drivers.rig import World, two_boards, two_buses


def test_a_silent_board_is_lost_once_and_nothing_is_sent_until_boot():
    world = World().up()
    world.boards.board("can0/5").silent = True
    world.run(2)
    assert world.told() == ["board-lost"]
    assert world.measured() == [-1, -1]
    assert world.master.status().boards[0].state == "lost"
    world.frames()
    with pytest.raises(Busy, match="can0/5"):
        world.master.commit(1, world.now)
    assert world.frames() == []
    world.boards.board("can0/5").silent = False
    world.up()
    world.commit(1, 0, then=0.1)
    assert world.measured() == [1, 0]


def test_a_lost_board_is_asked_whether_it_is_back():
    world = World().up()
    board = world.boards.board("can0/5")
    board.silent = True
    world.run(1)
    assert not world.master.back
    world.master.probe_silent(world.now)
    world.run(1)
    assert not world.master.back
    board.silent = False
    board.objects.set_data(0x1017, 0, bytes(2))  # it came back with no heartbeat of its own
    world.master.probe_silent(world.now)
    world.run(0.1)
    assert world.master.back
    world.up()


@pytest.mark.parametrize("seconds", [0.2, 0.24])
def test_a_stall_of_the_loop_alone_loses_nobody(seconds):
    world = World().up()
    world.run(0.05)
    world.stall(seconds)
    world.run(0.5)
    assert world.faults == []
    assert world.master.outputs_known


def test_a_master_that_was_halted_knows_no_states_until_boot():
    world = World().up()
    world.commit(1, 0, then=0.1)
    world.stalled = True
    world.run(0.5)
    fault = world.master.find_pause(world.now)
    assert (fault.code, fault.source) == ("halted", "executor")
    assert "0.5" in fault.message
    assert world.master.find_pause(world.now) is None
    assert world.measured() == [-1, -1]
    with pytest.raises(Busy, match="can0/5"):
        world.master.commit(2, world.now)
    world.stalled = False
    world.run(0.5)
    world.up()
    assert world.measured() == [1, 0]
    assert world.switches() == [1, 0]


def test_a_pause_that_ends_before_the_boards_lose_their_master_is_no_halt():
    world = World().up()
    period, timeout = world.timing.heartbeat, world.timing.heartbeat_timeout
    world.buses["can0"].log.clear()
    world.until(lambda: any(frame.id == 0x77F for frame in world.buses["can0"].log))
    beat = world.now
    world.stalled = True
    world.run(beat + timeout - 0.03 - world.now)
    assert timeout - period < world.now - beat < timeout
    assert world.master.find_pause(world.now) is None


def test_a_heartbeat_that_was_not_sent_shortens_no_halt():
    world = World().up()
    period, timeout = world.timing.heartbeat, world.timing.heartbeat_timeout
    world.frames()
    world.until(lambda: any(frame.id == 0x77F for frame in world.buses["can0"].log or ()))
    beat = world.now
    world.run(period - 0.02)
    world.buses["can0"].room = 0
    world.run(0.03)  # the next heartbeat and its repetition are not sent
    world.stalled = True
    world.run(beat + timeout + 0.02 - world.now)
    assert world.master.find_pause(world.now) is not None


def test_tick_reports_a_halt_as_well():
    world = World().up()
    world.stall(0.5)
    assert "halted" in world.told()
    assert world.told().count("halted") == 1


@pytest.mark.parametrize("cob_id", [0x000, 0x080, 0x205, 0x77F])
def test_another_master_is_reported(cob_id):
    world = World().up()
    world.say(cob_id, b"\x05" * (cob_id != 0x080))
    world.run(0.01)
    assert world.told() == ["foreign-master"]
    assert world.faults[0].source == "can0"
    assert f"{cob_id:03X}h" in world.faults[0].message
    assert world.master.status().buses[0].ignored == 0


@pytest.mark.parametrize("state", [State.BOOT_UP, State.PRE_OPERATIONAL, State.STOPPED])
def test_a_device_with_the_node_id_of_the_master_is_no_other_master(state):
    world = World().up()
    world.say(0x77F, bytes([state]))
    world.run(0.01)
    [fault] = world.faults
    assert (fault.code, fault.source) == ("duplicate-node", "can0")
    assert "has node id 127" in fault.message
    assert "hyperbit node-id" in fault.message


def test_a_board_that_leaves_operational_is_told_with_the_remedy():
    world = World().up()
    world.say(0x705, bytes([State.PRE_OPERATIONAL]))
    world.run(0.01)
    [fault] = world.faults
    assert (fault.code, fault.source) == ("board-stopped", "can0/5")
    assert "without a command and is pre-operational now: read its errors" in fault.message
    assert fault.message.endswith("hyperbit board ARM.yaml can0/5 reset --communication")


def test_another_program_on_the_same_computer_is_another_master():
    world = World().up()
    world.master.receive_event(FrameEchoed("can0", Frame(0x205, b"\x00"), None), world.now)
    assert world.told() == ["foreign-master"]


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x2320, "output short circuit (2320h)"),
        (0x2345, "current at the output side (2345h)"),
        (0x5112, "device hardware (5112h)"),
        (0xFF01, "device specific (FF01h)"),
        (0xB123, "unknown error (B123h)"),
        (0x0123, "unknown error (0123h)"),
    ],
)
def test_an_emergency_is_reported_in_words(code, words):
    world = World().up()
    emergency = code.to_bytes(2, "little") + b"\x01\0\0\0\0\0"
    world.say(0x085, emergency)
    world.say(0x085, emergency)
    world.run(0.01)
    assert world.master.status().boards[0].emergency == words
    world.say(0x085, bytes(8))
    world.run(0.01)
    assert world.master.status().boards[0].emergency is None
    assert world.told() == ["emergency"]
    assert words in world.faults[0].message


def test_a_storm_of_emergencies_is_one_fault():
    world = World().up()
    for code in range(0x2300, 0x2400):
        world.say(0x085, code.to_bytes(2, "little") + bytes(6))
    world.run(0.1)
    assert world.master.status().boards[0].emergency == "current at the output side (23FFh)"
    (fault,) = world.faults
    assert fault.message == (
        "board can0/5: it reports current at the output side (2300h): remove the cause, then reset"
    )


def test_too_few_inputs_are_a_fault_and_no_state():
    world = World().up()
    world.say(0x185, b"")
    world.run(0.01)
    assert world.told() == ["wrong-length"]
    assert "its inputs came in 0 bytes, not in 1" in world.faults[0].message
    assert world.measured() == [0, 0]


def test_the_first_bytes_of_longer_inputs_count_with_one_warning():
    world = World().up()
    for data in (b"\x01\xff", b"\x03" + bytes(7), b"\x01" + bytes(7)):
        world.say(0x185, data)
        world.run(0.01)
        assert world.measured() == [data[0] & 1, data[0] >> 1]
    assert world.told() == []
    [limits] = world.master.warnings()
    assert limits.code == "board-limits"
    assert "its inputs come in 2 bytes, though 1 are mapped: only the first ones are used" in limits.message
    assert "8 bytes" in limits.message


def test_error_frames_change_the_state_of_the_bus():
    world = World().up()
    for state in ("warning", "passive", "active"):
        world.master.receive_event(BusChanged("can0", state, "", (130, 7)), world.now)
        assert world.master.status().buses[0].state == state
        assert [f.code for f in world.master.warnings()] == (["bus-passive"] if state == "passive" else [])
    world.master.receive_event(BusChanged("can0", None, "", (1, 2)), world.now)
    status = world.master.status().buses[0]
    assert (status.state, status.tx_errors, status.rx_errors) == ("active", 1, 2)
    assert world.faults == []


@pytest.mark.parametrize("told", [True, False])
def test_after_bus_off_nothing_is_sent_until_boot(told):
    world = World().up()
    world.boards.board("can0/5").silent = True
    world.buses["can0"].go_off()
    assert world.told() == ["bus-off"]
    world.run(0.01)
    world.buses["can0"].log.clear()
    world.run(1)
    with pytest.raises(Busy, match="bus-off"):
        world.master.commit(1, world.now)
    world.boot()
    assert [fault.code for fault in world.master.boot_faults] == ["bus-off"]
    assert world.buses["can0"].log == []
    if told:
        world.buses["can0"].restore()
    world.buses["can0"].state = "active"
    world.boards.board("can0/5").silent = False
    world.run(0.2)  # its heartbeat shows that the bus is back
    assert world.master.status().buses[0].state == "active"
    with pytest.raises(Busy, match="booted"):
        world.master.commit(1, world.now)
    world.run(0.2)
    assert world.master.back
    world.up()
    world.commit(1, 0, then=0.1)
    assert world.measured() == [1, 0]


def test_a_bus_that_goes_down_loses_only_its_boards():
    world = World(two_buses()).up()
    world.buses["can1"].go_down()
    assert [(f.code, f.source, f.message) for f in world.faults] == [
        ("bus-down", "can1", "can1: the interface is down")
    ]
    assert world.measured() == [0, -1]
    world.run(1)
    world.buses["can1"].restore()
    world.run(0.3)
    assert world.master.back
    world.up()


def test_a_fault_is_reported_again_after_boot():
    world = World().up()
    for _ in range(2):
        world.say(0x080)
        world.say(0x080)
        world.run(0.01)
        world.up()
    assert world.told() == ["foreign-master"] * 2


def test_a_question_reads_inputs_whose_tpdo_was_lost():
    world = World(two_boards()).up()
    world.lost = lambda bus, frame: frame.id == 0x185
    world.commit(1, 0, then=0.1)
    assert world.measured() == [0, 0]
    world.frames()
    world.master.question(0, world.now)
    assert world.master.questioning(0)
    assert not world.master.questioning(1)
    world.until(lambda: not world.master.questioning(0))
    assert world.measured() == [1, 0]
    assert world.frames(sdo=True) == [(0x605, "40 00 60 01 00 00 00 00"), (0x585, "4f 00 60 01 01 00 00 00")]


def test_a_question_that_is_not_answered_times_out():
    world = World(timing=Timing(heartbeat_timeout=60.0)).up()
    world.boards.board("can0/5").silent = True
    world.master.question(0, world.now)
    assert 0.5 < world.until(lambda: not world.master.questioning(0)) < 1.0


def test_a_second_question_is_asked_after_the_first():
    world = World().up()
    world.frames()
    world.master.question(0, world.now)
    world.master.question(0, world.now)
    world.until(lambda: not world.master.questioning(0))
    world.run(0.01)
    asked = [cob_id for cob_id, data in world.frames(sdo=True) if data[3:11] == "00 60 01"]
    assert asked == [0x605, 0x585] * 2


def test_status_counts_frames_and_load():
    world = World().up()
    before = world.master.status().buses[0]
    for _ in range(1000):
        world.say(0x300, bytes(8))
    world.run(1.1)
    frames = world.master.status().buses[0].rx_frames
    world.master.receive_event(FrameIgnored("can0", 100), world.now)
    after = world.master.status().buses[0]
    assert after.rx_frames == frames + 1
    assert after.ignored == before.ignored + 1001
    assert after.rx_frames >= before.rx_frames + 1001
    assert 0.1 <= after.load < 0.2  # 1,000 frames of 135 bits in a second of 1 Mbit/s
    assert after.worst_case.load > 0
    assert world.master.status().boards[0].state == "operational"
    assert world.master.status().boards[0].heartbeat_age < 0.2
