from __future__ import annotations

import threading

import pytest

from drivers.boards import Boards
from drivers.cia301 import State
from drivers.faults import BusError
from drivers.wiring import BusSettings, Channel, Timing, Wiring


def test_a_missing_board_is_named_and_the_others_come_up(make_rig, patient, two_boards):
    rig = make_rig(two_boards, timing=patient(boot_timeout=0.2))
    rig.simulation.fault("silence", "can0/5")
    rig.boot()
    [fault] = rig.boards.start()
    assert (fault.code, fault.source) == ("board-missing", "can0/5")
    assert rig.boards.measured().tolist() == [-1, 0]
    rig.simulation.fault("unsilence", "can0/5")
    assert rig.boards.start() == []


def test_every_board_has_its_own_fault(make_rig, patient):
    rig = make_rig([Channel(str(n), "can0", n, 0, 0) for n in (1, 2, 3, 4)], timing=patient(boot_timeout=0.2))
    rig.simulation.fault("silence", "can0/1")
    with rig.simulation.board("can0/2") as board:
        board.objects.refused[0x1000, 0] = 0x08000000
    with rig.simulation.board("can0/3") as board:
        board.objects.refused[0x1016, 1] = 0x06090030
    rig.boot()
    assert sorted((f.source, f.code) for f in rig.boards.start()) == [
        ("can0/1", "board-missing"),
        ("can0/2", "sdo-refused"),
        ("can0/3", "sdo-refused"),
    ]


@pytest.mark.parametrize(
    ("device_type", "words"), [(0x00020192, "00020192h"), (0x00010191, "outputs"), (0x00020191, "outputs and inputs")]
)
def test_a_wrong_device_is_told_from_its_type(make_rig, device_type, words):
    rig = make_rig()
    rig.boot()
    with rig.simulation.board("can0/5") as board:
        board.objects.put(0x1000, 0, device_type)
    [fault] = rig.boards.start()
    assert (fault.code, fault.source) == ("wrong-device", "can0/5")
    assert words in fault.message


def test_a_board_without_inputs_does_where_none_is_wired(make_rig):
    rig = make_rig([Channel("a", "can0", 5, 0, None)])
    rig.boot()
    with rig.simulation.board("can0/5") as board:
        board.objects.put(0x1000, 0, 0x00020191)
    assert rig.boards.start() == []
    assert not any(data[3:8] in ("00 18", "00 1a") for cob_id, data in rig.frames() if cob_id == 0x605)


def test_a_refusal_names_object_value_and_reason(make_rig):
    rig = make_rig()
    with rig.simulation.board("can0/5") as board:
        board.objects.refused[0x1600, 1] = 0x06040041
    rig.boot()
    [fault] = rig.boards.start()
    assert fault.code == "sdo-refused"
    for word in ("can0/5", "1600h sub 1", "62000108h", "cannot be mapped", "06040041h"):
        assert word in fault.message


@pytest.mark.parametrize("absent", [(0x1006, 0), (0x1029, 1), (0x6005, 0), (0x1400, 5), (0x1800, 5)])
def test_optional_objects_may_be_absent(make_rig, absent):
    rig = make_rig()
    with rig.simulation.board("can0/5") as board:
        board.objects.refused[absent] = 0x06020000 if absent[1] == 0 else 0x06090011
    rig.boot()
    assert rig.boards.start() == []


def test_a_board_that_boots_late_is_waited_for(make_rig, wait):
    rig = make_rig()
    rig.boot()
    rig.simulation.fault("power_cut", "can0/5")
    found = []
    thread = threading.Thread(target=lambda: found.append(rig.boards.start()))
    thread.start()
    wait(lambda: (0x605, "40 00 10 00 00 00 00 00") in rig.frames())
    rig.simulation.fault("power_on", "can0/5")
    thread.join(30)
    assert found == [[]]


def test_a_stopped_board_comes_up(make_rig, wait):
    rig = make_rig().up()
    rig.say(0, b"\x02\x05")
    wait(lambda: "board-stopped" in rig.codes())
    assert rig.boards.start() == []
    rig.commit(1, 0)
    rig.arrive(1, 0)


def test_a_second_driver_switches_nothing_and_adopts_the_states(make_rig, two_boards):
    rig = make_rig(two_boards).up()
    rig.commit(1, 0)
    rig.arrive(1, 0)
    rig.boards.close()
    rig.boards = rig.driver()
    rig.boards.connect()
    rig.frames()
    assert rig.boards.start() == []
    rig.boards.hold()
    assert not any(cob_id == 0 for cob_id, _ in rig.frames())  # all was as it should be: no board left operational
    assert rig.boards.measured().tolist() == [1, 0]
    rig.commit(1, 0)
    assert rig.frames() == []
    assert rig.simulation.switches().tolist() == [1, 0]


@pytest.mark.parametrize("on_loss", ["hold", "contract"])
def test_a_second_driver_with_another_configuration_switches_nothing(make_rig, two_boards, patient, on_loss):
    rig = make_rig(two_boards, on_loss=on_loss).up()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    rig.boards.close()
    rig.timing = patient(heartbeat=0.03)
    rig.boards = rig.driver()
    rig.boards.connect()
    rig.frames()
    assert rig.boards.start() == []
    assert [data for cob_id, data in rig.frames() if cob_id == 0] == ["80 05", "01 05", "80 09", "01 09"]
    assert rig.boards.measured().tolist() == [1, 1]
    assert rig.simulation.switches().tolist() == [1, 1]


def test_outputs_that_are_no_actuators_keep_their_values(make_rig):
    rig = make_rig()
    rig.boot()
    with rig.simulation.board("can0/5") as board:
        board.objects.put(0x6200, 1, 0x50)
    assert rig.boards.start() == []
    rig.frames()
    rig.commit(1, 0)
    assert rig.frames()[:2] == [(0x205, "51"), (0x080, "")]


def test_start_keeps_boards_that_are_fine_operational(make_rig, two_boards, wait):
    rig = make_rig(two_boards).up()
    rig.commit(1, 1)
    rig.arrive(1, 1)
    rig.simulation.fault("power_cut", "can0/9")
    rig.simulation.fault("power_on", "can0/9")
    wait(lambda: "board-rebooted" in rig.codes())
    rig.frames()
    assert rig.boards.start() == []
    assert (0, "01 05") not in rig.frames()
    rig.arrive(1, 0)
    with rig.simulation.board("can0/5") as board:
        assert board.state == State.OPERATIONAL
    assert rig.simulation.switches().tolist() == [1, 2]  # the power cut switched the second back


@pytest.mark.parametrize("interface", ["nonsense", "socketcan"])
def test_a_bus_that_cannot_be_opened_is_named(interface):
    wiring = Wiring((BusSettings("can7", interface, "nowhere0"),), (Channel("a", "can7", 1, 0, 0),))
    with pytest.raises(BusError, match=rf"can7.*nowhere0.*{interface}"):
        Boards(wiring, Timing()).connect()


def test_start_before_connect_says_so():
    wiring = Wiring((BusSettings("can7", "virtual", "never"),), (Channel("a", "can7", 1, 0, 0),))
    [fault] = Boards(wiring, Timing()).start()
    assert (fault.code, fault.source) == ("bus-down", "can7")
