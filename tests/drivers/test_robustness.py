"""No frame, whatever its identifier, kind or length, ends a thread or moves what it should not."""

from __future__ import annotations

import struct
import threading

import can
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.cia301 import frame
from drivers.simulation.actuator import Actuator
from drivers.simulation.firmware import SimulatedBoard, Wired

NODE = 5
OURS = [base + NODE for base in (0x080, 0x180, 0x200, 0x580, 0x600, 0x700)]
COB_IDS = st.sampled_from([*OURS, 0x000, 0x080, 0x77F, 0x7E4]) | st.integers(0, 0x7FF)
INDICES = st.sampled_from([0x1003, 0x1016, 0x1017, 0x1029, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6005, 0x6200, 0x6206])
VALUES = st.sampled_from([0, 1, 8, 255, 0x62000108, 0x60000108, 0x10010008, 0x00050008, 0x80000205, 0x7F0064])
DOWNLOADS = st.builds(
    lambda index, sub, value, size: (
        0x600 + NODE,
        struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value & (1 << 8 * size) - 1),
    ),
    INDICES,
    st.integers(0, 9),
    VALUES,
    st.sampled_from([1, 2, 4]),
)
FRAMES = st.lists(st.tuples(COB_IDS, st.binary(max_size=8)) | DOWNLOADS, max_size=30)
# What may move an actuator by right: commands, RPDOs, and SDO downloads.
MOVING = {0x000, 0x200 + NODE, 0x600 + NODE}


@settings(max_examples=150, deadline=None)
@given(frames=FRAMES)
def test_firmware_survives_any_data_frame(frames):
    actuator = Actuator("a", 0.1)
    board = SimulatedBoard(NODE, [Wired(actuator, 0, 0)], frame)
    board.power_on(0.0)
    board.receive(0, bytes([1, NODE]), 0.0)
    for i, (cob_id, data) in enumerate(frames):
        board.receive(cob_id, data, 0.01 * i)
    board.step(1000.0)
    if not MOVING & {cob_id for cob_id, _ in frames}:
        assert (actuator.switches, actuator.position) == (0, 0)


MESSAGES = st.builds(
    can.Message,
    arbitration_id=COB_IDS,
    data=st.binary(max_size=8),
    is_extended_id=st.booleans(),
    is_remote_frame=st.just(False),
    is_error_frame=st.booleans(),
) | st.builds(can.Message, arbitration_id=COB_IDS, dlc=st.integers(0, 8), is_remote_frame=st.just(True))


def test_driver_survives_any_frame_and_moves_nothing(make_rig, wait):
    """The frames go to the driver's reader as its bus hands them over; what it sends because of them is heard."""
    rig = make_rig().up()
    bus = rig.boards._buses["can0"]
    reader = bus._reader

    @settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(messages=st.lists(MESSAGES, max_size=30))
    def attack(messages):
        for message in messages:
            bus._bus.queue.put(message)
        rig.boards.measured()
        rig.boards.status()

    attack()
    wait(bus._bus.queue.empty)
    assert reader.is_alive()
    assert rig.frames() == []
    assert rig.simulation.switches().tolist() == [0, 0]
    assert {fault.code for fault in rig.faults} <= {
        "foreign-master",
        "emergency",
        "board-rebooted",
        "board-stopped",
        "wrong-length",
        "bus-off",
    }
    bus._bus.queue.put(can.Message(arbitration_id=0x100, is_error_frame=True))
    wait(lambda: bus.usable)
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_simulation_survives_any_kind_of_frame(make_rig, wait):
    rig = make_rig().up()
    threads = [t for t in threading.enumerate() if t.name.startswith("simulate")]
    for cob_id in (*OURS, 0, 0x80):
        rig.say(cob_id, is_extended_id=True)
        rig.say(cob_id, is_remote_frame=True)
        rig.say(cob_id, is_error_frame=True)
        if cob_id != 0x205:
            rig.say(cob_id, b"\x02")
    assert all(t.is_alive() for t in threads)
    assert rig.simulation.switches().tolist() == [0, 0]
