from __future__ import annotations

import can
import pytest

from drivers.faults import BusBusy


def test_a_silent_board_is_lost_once_and_nothing_is_sent_until_start(make_rig):
    rig = make_rig().up()
    rig.simulation.fault("silence", "can0/5")
    rig.pass_time(200, step=5)
    assert rig.codes() == ["board-lost"]
    assert rig.boards.measured().tolist() == [-1, -1]
    assert rig.boards.status().boards[0].state == "lost"
    rig.frames()
    with pytest.raises(BusBusy, match="can0/5"):
        rig.commit(1, 0)
    assert rig.frames() == []
    rig.simulation.fault("unsilence", "can0/5")
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_one_late_tick_loses_no_board(make_rig):
    rig = make_rig().up()
    rig.pass_time(0.05)
    rig.boards.tick(rig.now + 1000)
    assert rig.faults == []


def test_a_reboot_is_told_and_start_adopts_what_it_left(make_rig, wait):
    rig = make_rig().up()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    rig.simulation.fault("power_cut", "can0/5")
    rig.simulation.fault("power_on", "can0/5")
    wait(lambda: rig.codes() == ["board-rebooted"])
    assert "can0/5" in rig.faults[0].message
    wait(lambda: rig.simulation.positions().tolist() == [0, 0])
    assert rig.boards.start() == []
    assert rig.boards.measured().tolist() == [0, 0]
    rig.pass_time(1)
    assert rig.codes() == ["board-rebooted"]


def test_a_board_put_pre_operational_by_someone_is_told(make_rig, wait):
    rig = make_rig().up()
    rig.say(0, b"\x80\x05")
    wait(lambda: set(rig.codes()) == {"foreign-master", "board-stopped"})


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x2320, "output short circuit (2320h)"),
        (0x2345, "current at the output side (2345h)"),
        (0x5112, "device hardware (5112h)"),
        (0xFF01, "device specific (FF01h)"),
        (0xB123, "unknown error (B123h)"),
    ],
)
def test_an_emergency_is_told_in_words(make_rig, wait, code, words):
    rig = make_rig().up()
    emergency = code.to_bytes(2, "little") + b"\x01\0\0\0\0\0"
    rig.say(0x085, emergency)
    rig.say(0x085, emergency)
    wait(lambda: rig.boards.status().boards[0].emergency == words)
    rig.say(0x085, bytes(8))
    wait(lambda: rig.boards.status().boards[0].emergency is None)
    assert rig.codes() == ["emergency"]
    assert words in rig.faults[0].message


@pytest.mark.parametrize("trouble", ["stuck", "slow", "sensor lost"])
def test_an_actuator_that_does_not_arrive_is_stuck(make_rig, trouble):
    rig = make_rig().up()
    if trouble == "stuck":
        rig.simulation.fault("stick", "5.left", 0)
    elif trouble == "slow":
        rig.simulation.fault("slow", "5.left", 1e9)
    else:
        rig.simulation.fault("lose_sensor", "5.left")
    rig.commit(1, 1)
    rig.arrive(0, 1)
    rig.pass_time(0.07)
    assert rig.boards.moving(rig.now)
    assert rig.faults == []
    rig.pass_time(0.5)
    assert rig.codes() == ["stuck"]
    assert rig.faults[0].source == "5.left (can0/5 output 0)"
    assert "extended within 0.08 s" in rig.faults[0].message
    assert not rig.boards.moving(rig.now)


def test_a_stuck_actuator_is_accepted_as_measured_by_start(make_rig):
    rig = make_rig().up()
    rig.simulation.fault("stick", "5.left", 0)
    rig.commit(1, 0)
    rig.pass_time(0.1)
    assert rig.codes() == ["stuck"]
    assert rig.boards.start() == []
    rig.pass_time(1)
    assert rig.boards.measured().tolist() == [0, 0]
    rig.frames()
    rig.commit(0, 0)
    assert rig.frames()[:2] == [(0x205, "00"), (0x080, "")]
    rig.pass_time(1)
    assert rig.codes() == ["stuck"]


def test_motion_nobody_commanded_is_told(make_rig):
    rig = make_rig().up()
    rig.simulation.fault("stick", "5.right", 1)
    rig.arrive(0, 1)
    rig.pass_time(0.1)
    assert rig.codes() == ["unexpected-motion"]
    assert rig.faults[0].source == "5.right (can0/5 output 1)"
    assert rig.boards.start() == []
    rig.pass_time(0.1)
    assert rig.codes() == ["unexpected-motion"]


def test_hold_takes_what_is_measured_as_right(make_rig):
    rig = make_rig().up()
    rig.simulation.fault("stick", "5.right", 1)
    rig.arrive(0, 1)
    rig.boards.hold()
    rig.pass_time(0.1)
    assert rig.faults == []


@pytest.mark.parametrize("cob_id", [0x000, 0x080, 0x205, 0x77F])
def test_another_master_is_told(make_rig, wait, cob_id):
    rig = make_rig().up()
    rig.say(cob_id, b"\x00")
    wait(lambda: rig.codes() == ["foreign-master"])
    assert rig.faults[0].source == "can0"
    assert f"{cob_id:03X}h" in rig.faults[0].message


def error(rig, kind: int, detail: int = 0, tx: int = 0, rx: int = 0) -> None:
    rig.say(kind, bytes([0, detail, 0, 0, 0, 0, tx, rx]), is_error_frame=True)


def test_error_frames_tell_the_state_of_the_bus(make_rig, wait):
    rig = make_rig().up()

    def state():
        return rig.boards.status().buses[0].state

    for detail, name in ((0x08, "warning"), (0x20, "passive"), (0x40, "active")):
        error(rig, 0x204, detail, 130, 7)
        wait(lambda name=name: state() == name)
    assert (rig.boards.status().buses[0].tx_errors, rig.boards.status().buses[0].rx_errors) == (130, 7)
    assert rig.faults == []


@pytest.mark.parametrize("restarted", [True, False])
def test_after_bus_off_nothing_is_sent_until_start(make_rig, wait, restarted):
    rig = make_rig().up()
    rig.simulation.fault("silence", "can0/5")
    error(rig, 0x40)
    wait(lambda: rig.codes() == ["bus-off"])
    rig.frames()
    rig.pass_time(1)
    with pytest.raises(BusBusy, match="bus-off"):
        rig.commit(1, 0)
    assert [fault.code for fault in rig.boards.start()] == ["bus-off"]
    assert rig.frames() == []
    if restarted:
        error(rig, 0x100)
    rig.simulation.fault("unsilence", "can0/5")
    wait(lambda: rig.boards.status().buses[0].state == "active")
    with pytest.raises(BusBusy, match="start"):
        rig.commit(1, 0)
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)
    assert rig.codes() == ["bus-off"]


def test_a_bus_that_goes_down_is_told_and_opened_again(make_rig, wait, monkeypatch):
    rig = make_rig().up()
    bus = rig.boards._buses["can0"]
    opened, gone = bus._open, [True]

    def open_():
        if gone[0]:
            raise can.CanInitializationError("no such device")
        return opened()

    monkeypatch.setattr(bus, "_open", open_)
    bus._bus.shutdown()
    wait(lambda: rig.codes() == ["bus-down"])
    assert "can0" in rig.faults[0].message
    assert rig.boards.status().buses[0].state == "down"
    rig.pass_time(1)
    with pytest.raises(BusBusy, match="can0"):
        rig.commit(1, 0)
    assert [fault.code for fault in rig.boards.start()] == ["bus-down"]
    gone[0] = False
    wait(lambda: rig.boards.status().buses[0].state == "active")
    with pytest.raises(BusBusy, match="can0"):
        rig.commit(1, 0)
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_a_subscriber_that_fails_stops_nothing(make_rig, wait):
    rig = make_rig()

    def fail(fault):
        raise RuntimeError("mine")

    rig.boards.subscribe(fail)
    rig.up()
    rig.say(0x080)
    wait(lambda: rig.codes() == ["foreign-master"])
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_status_counts_frames_and_load(make_rig, wait):
    rig = make_rig().up()
    rig.pass_time(0.01)
    before = rig.boards.status().buses[0]
    for _ in range(1000):
        rig.say(0x300, bytes(8))
    wait(lambda: rig.boards.status().buses[0].ignored >= 1000)
    rig.pass_time(1.01)
    after = rig.boards.status().buses[0]
    assert after.rx_frames >= before.rx_frames + 1000
    assert 0.135 <= after.load < 0.2  # 1,000 frames of 135 bits in a second of 1 Mbit/s
    assert after.bits_per_second == pytest.approx(1e6 * after.load)
    assert 1000 / 1.1 < after.frames_per_second < after.bits_per_second / 55
    assert rig.boards.status().boards[0].state == "operational"
    assert rig.boards.status().boards[0].heartbeat_age < 1.1


@pytest.mark.parametrize(("on_loss", "states"), [("hold", [1, 0]), ("contract", [0, 0])])
def test_boards_left_by_their_master_hold_or_contract(make_rig, patient, wait, on_loss, states):
    rig = make_rig(timing=patient(heartbeat_timeout=0.3), on_loss=on_loss).up()
    rig.commit(1, 0)
    rig.arrive(1, 0)
    rig.pass_time(0.01)  # the first heartbeat, and the last
    wait(lambda: {"emergency", "board-stopped"} <= set(rig.codes()))
    wait(lambda: rig.simulation.positions().tolist() == states)
    rig.say(0x205, b"\x03")
    rig.say(0x080)
    assert rig.boards.start() == []
    assert rig.simulation.positions().tolist() == states
    assert rig.boards.measured().tolist() == states


@pytest.mark.parametrize("data", [b"", b"\x03\x03", bytes(8)])
def test_inputs_of_a_wrong_length_are_a_fault_and_no_state(make_rig, wait, data):
    rig = make_rig().up()
    rig.say(0x185, data)
    wait(lambda: rig.codes() == ["wrong-length"])
    assert rig.faults[0].source == "can0/5"
    assert f"its inputs came in {len(data)} bytes, not in 1" in rig.faults[0].message
    assert rig.boards.measured().tolist() == [0, 0]
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_a_storm_of_emergencies_is_one_fault(make_rig, wait):
    rig = make_rig().up()
    for code in range(0x2300, 0x2400):
        rig.say(0x085, code.to_bytes(2, "little") + bytes(6))
    wait(lambda: rig.boards.status().boards[0].emergency == "current at the output side (23FFh)")
    assert [fault.message for fault in rig.faults] == ["board can0/5: it reports current at the output side (2300h)"]


def test_a_defect_is_written_to_the_journal_once(make_rig, wait, monkeypatch, caplog):
    rig = make_rig().up()
    bus = rig.boards._buses["can0"]

    def fail(message):
        raise RuntimeError("nobody thought of it")

    monkeypatch.setattr(bus, "_on_frame", fail)
    before = rig.boards.status().buses[0].ignored
    for _ in range(100):
        rig.say(0x300)
    wait(lambda: rig.boards.status().buses[0].ignored >= before + 100)
    assert [record.message.split(" Timestamp")[0] for record in caplog.records] == ["can0: cannot handle"]


def test_a_daemon_that_was_halted_is_told_so_and_the_boards_states_are_unknown(make_rig, patient):
    rig = make_rig(timing=patient(heartbeat_timeout=2.0)).up()
    rig.pass_time(0.1)
    assert rig.boards.halted(rig.now + 1.9) is None
    fault = rig.boards.halted(rig.now + 2.1)
    assert (fault.code, fault.source) == ("halted", "daemon")
    assert "2.10 s" in fault.message
    assert rig.boards.measured().tolist() == [-1, -1]
    with pytest.raises(BusBusy, match="can0/5"):
        rig.commit(1, 0)
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)
