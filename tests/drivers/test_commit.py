from __future__ import annotations

import threading

import numpy as np
import pytest

from drivers.bus import CanBus
from drivers.faults import BusBusy
from drivers.wiring import Channel, Timing


def test_two_buses_get_all_rpdos_before_the_first_sync(make_rig, monkeypatch):
    rig = make_rig([Channel("a", "can0", 5, 0, 0), Channel("b", "can1", 5, 0, 0), Channel("c", "can1", 6, 0, 0)]).up()
    sent = []
    send = CanBus.send

    def record(bus, message, timeout=None):
        sent.append((bus.name, message.arbitration_id))
        send(bus, message, timeout)

    monkeypatch.setattr(CanBus, "send", record)
    rig.commit(1, 1, 1)
    assert sent == [("can0", 0x205), ("can1", 0x205), ("can1", 0x206), ("can0", 0x080), ("can1", 0x080)]
    rig.arrive(1, 1, 1)


def test_several_modules_and_more_than_eight_outputs_on_a_board(make_rig):
    places = [(0, 1), (3, 0), (8, 13), (17, 9), (63, 63)]
    rig = make_rig([Channel(f"{o}", "can0", 3, o, i) for o, i in places]).up()
    rig.commit(1, 0, 1, 0, 1)
    rig.arrive(1, 0, 1, 0, 1)
    assert rig.frames()[:2] == [(0x203, "01 01 00 80"), (0x080, "")]  # subs 1, 2, 3 and 8
    rig.commit(0, 1, 0, 1, 0)
    rig.arrive(0, 1, 0, 1, 0)
    assert rig.simulation.positions().tolist() == [0, 1, 0, 1, 0]


@pytest.mark.parametrize("shared", [False, True])
def test_sixty_four_actuators_on_eight_boards(make_rig, shared):
    channels = [Channel(f"{n}.{o}", "can0", n, o, o) for n in range(1, 9) for o in range(8)]
    rig = make_rig(channels, shared_rpdo=shared).up()
    states = np.random.default_rng(1).integers(0, 2, 64)
    rig.commit(*states)
    rig.arrive(*states)
    frames = rig.frames()
    assert frames.index((0x080, "")) == (1 if shared else 8)


def test_shared_frames_hold_eight_bytes_and_no_board_in_two(make_rig):
    channels = [Channel(f"{n}.{o}", "can0", n, o, o) for n in (1, 2, 3) for o in (0, 8, 16)]
    rig = make_rig(channels, shared_rpdo=True).up()
    rig.commit(*[1] * 9)
    rig.arrive(*[1] * 9)
    assert [f for f in rig.frames() if f[0] < 0x280][:3] == [
        (0x201, "01 01 01 01 01 01"),
        (0x203, "01 01 01"),
        (0x080, ""),
    ]


@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_busy_bus_gets_no_sync_and_later_the_latest_states_only(make_rig, two_boards, after):
    rig = make_rig(two_boards).up()
    rig.commit(0, 1)
    rig.arrive(0, 1)
    rig.frames()
    release = rig.choke("can0", after)
    with pytest.raises(BusBusy, match="can0"):
        rig.commit(1, 0)
    assert (0x080, "") not in rig.frames()
    assert not rig.boards.moving(rig.now)
    release()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    frames = rig.frames()
    assert (0x205, "01") in frames or after > 0
    assert (0x209, "00") not in frames
    assert frames.count((0x080, "")) == 1
    assert rig.simulation.switches().tolist() == [1, 1]
    assert rig.boards.status().buses[0].dropped == 1


def test_a_sync_that_fails_on_the_second_bus_is_sent_with_the_next_commit(make_rig):
    rig = make_rig([Channel("a", "can0", 5, 0, 0), Channel("b", "can1", 5, 0, 0)]).up()
    release = rig.choke("can1", 1)
    with pytest.raises(BusBusy, match="can1"):
        rig.commit(1, 1)
    rig.arrive(1, 0)
    release()
    rig.pass_time(0.2)
    assert rig.faults == []
    for bus in ("can0", "can1"):
        rig.frames(bus)
    rig.commit(1, 1)
    rig.arrive(1, 1)
    assert rig.frames("can0") == []
    assert rig.frames("can1") == [(0x080, ""), (0x185, "01")]


def test_a_commit_back_to_the_old_states_after_a_busy_bus_clears_what_waits_in_the_boards(make_rig, two_boards):
    rig = make_rig(two_boards).up()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    release = rig.choke("can0", 1)
    with pytest.raises(BusBusy):
        rig.commit(0, 0)
    release()
    rig.frames()
    rig.commit(1, 1)
    assert rig.frames()[:2] == [(0x205, "01"), (0x209, "08")]
    assert rig.simulation.switches().tolist() == [1, 1]


def test_moving_until_the_end_stop_says_so(make_rig):
    rig = make_rig().up()
    rig.simulation.fault("slow", "5.left", 1e9)
    rig.commit(1, 0)
    assert rig.boards.moving(rig.now)
    rig.simulation.fault("slow", "5.left", 1)
    rig.arrive(1, 0)
    assert not rig.boards.moving(rig.now)


def test_moving_for_the_travel_time_without_an_end_stop(make_rig):
    rig = make_rig([Channel("a", "can0", 5, 0, None)]).up()
    assert rig.boards.sensed.tolist() == [False]
    rig.commit(1)
    assert rig.boards.measured().tolist() == [1]
    assert rig.boards.moving(rig.now + 0.049)
    assert not rig.boards.moving(rig.now + 0.051)


def test_an_actuator_that_is_held_is_in_its_state_whatever_its_output_unless_its_end_stop_tells(make_rig):
    rig = make_rig([Channel("a", "can0", 5, 0, 0), Channel("b", "can0", 5, 1, None), Channel("c", "can0", 5, 2, None)])
    rig.up().boards.degrade(np.array([1, 1, -1], dtype=np.int8))
    assert rig.boards.measured().tolist() == [0, 1, 0]
    assert rig.boards.outputs().tolist() == [0, 0, 0]
    assert rig.frames() == []
    rig.commit(0, 1, 1)
    assert (rig.boards.measured().tolist(), rig.boards.outputs().tolist()) == ([0, 1, 1], [0, 1, 1])
    rig.boards.degrade(np.array([-1, 0, -1], dtype=np.int8))
    assert rig.boards.measured().tolist() == [0, 0, 1]


def test_an_actuator_called_back_halfway_moves_for_the_travel_time(make_rig):
    rig = make_rig().up()
    rig.simulation.fault("slow", "5.left", 1e9)
    rig.commit(1, 0)
    rig.commit(0, 0)
    assert rig.boards.moving(rig.now + 0.049)
    assert not rig.boards.moving(rig.now + 0.051)
    rig.pass_time(0.2)
    assert rig.faults == []


def test_commit_before_start_is_refused(make_rig):
    rig = make_rig()
    rig.boot()
    with pytest.raises(BusBusy, match="start"):
        rig.commit(1, 0)
    assert rig.frames() == []


@pytest.mark.parametrize("states", [[1], [1, 0, 1], [2, 0], [-1, 0], [[1, 0]]])
def test_wrong_states_are_refused(make_rig, states):
    rig = make_rig().up()
    with pytest.raises(ValueError, match="2 of 0 or 1"):
        rig.boards.commit(np.array(states, dtype=np.int8), rig.now)
    assert rig.frames() == []


def test_no_sync_is_sent_while_rpdos_have_not_left(make_rig, two_boards, wait):
    """The word that they have left is kept back, as when the bus takes frames and lets none through."""
    rig = make_rig(two_boards).up()
    bus = rig.boards._buses["can0"]
    receive = bus._bus.recv
    kept, keeping = [], threading.Event()
    keeping.set()

    def keep(timeout=None):
        message = receive(timeout)
        if message is not None and not message.is_rx and keeping.is_set():
            kept.append(message)
            return None
        return message

    bus._bus.recv = keep
    wait(lambda: bus._bus.queue.empty())
    with pytest.raises(BusBusy, match="left yet"):
        rig.boards.commit(np.array([1, 1], np.uint8), rig.now)
    assert [cob_id for cob_id, _ in rig.frames()] == [0x205, 0x209]
    assert rig.boards.outputs().tolist() == [0, 0]
    keeping.clear()
    for message in kept:
        bus._bus.queue.put(message)
    rig.commit(1, 1)
    rig.arrive(1, 1)
    assert rig.frames()[0] == (0x080, "")
    assert rig.boards.outputs().tolist() == [1, 1]


def test_a_bus_on_which_nothing_leaves_is_lost_and_start_brings_it_back(make_rig, wait):
    rig = make_rig(timing=Timing(heartbeat=0.02, heartbeat_timeout=1.0, boot_timeout=20.0)).up()
    release = rig.choke("can0", 0)

    def lost():
        rig.pass_time(0.02)
        return "bus-busy" in rig.codes()

    wait(lost)
    assert rig.boards.measured().tolist() == [-1, -1]
    assert not rig.boards.back()
    release()

    def back():
        rig.pass_time(0.02)
        return rig.boards.back()

    wait(back)
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_inputs_whose_tpdo_was_lost_are_asked_for_until_they_tell(make_rig, wait):
    rig = make_rig().up()
    lost = []
    with rig.simulation.board("can0/5") as board:
        say = board._bus
        board._bus = lambda cob_id, data: lost.append(data) if cob_id == 0x185 else say(cob_id, data)
    rig.commit(1, 0)
    wait(lambda: lost)
    rig.frames()
    rig.pass_time(0.06)
    rig.arrive(1, 0)
    rig.pass_time(0.01)
    asked = [data for cob_id, data in rig.frames() if cob_id == 0x605]
    assert set(asked) == {"40 00 60 01 00 00 00 00"}
    rig.pass_time(0.5)
    assert "40 00 60 01 00 00 00 00" not in [data for _, data in rig.frames()], "it has arrived"
    assert rig.faults == []
