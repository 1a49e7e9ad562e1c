"""Boards and actuators that fail, a second master: it is told by name, and nothing moves that no goal asked for."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import can
import numpy as np
import pytest

from controller.config import Arm
from drivers import cia301
from drivers.cia301 import Command, State
from drivers.simulation.simulation import Simulation
from drivers.wiring import BusSettings, Timing
from tests.daemon.waiting import SLOWNESS, eventually
from tests.integration.conftest import Bench, bearing
from tests.integration.harness import Observer, board_names, wired
from tests.integration.motions import Motions
from tests.integration.test_bus_faults import aborted, ready_by_itself, running
from tests.integration.test_faults import first_to_switch, reset
from tests.integration.test_goals import LEFT, MIDDLE, RIGHT

Answer = Callable[[int, bytes], list[tuple[int, bytes]]]


@contextmanager
def answering(boards: Simulation, name: str, answer: Answer) -> Iterator[None]:
    """Lets a board say something else, or nothing, in place of what it would."""
    with boards.board(name) as board:
        say = board._bus
        board._bus = lambda cob_id, data: [say(*frame) for frame in answer(cob_id, data)]
    yield
    with boards.board(name) as board:
        board._bus = say


def test_a_silent_board_is_told_and_when_it_is_heard_again_the_arm_is_ready(
    client: Observer, boards: Simulation, motions: Motions
) -> None:
    running(client)
    silenced = time.time()
    boards.fault("silence", "can0/5")
    state = client.wait_fault("board-lost", silenced, within=1.0)
    assert "can0/5" in state["reason"]
    aborted(client, "a", "can0/5")
    back = time.time()
    boards.fault("unsilence", "can0/5")
    ready_by_itself(client, boards, back)


def test_a_board_that_reboots_is_told_and_waits_for_reset(
    client: Observer, boards: Simulation, motions: Motions
) -> None:
    running(client)
    rebooted = time.time()
    boards.fault("power_cut", "can0/7")
    boards.fault("power_on", "can0/7")
    client.wait_fault("board-rebooted", rebooted, within=1.0)
    aborted(client, "a", "can0/7")
    eventually(lambda: not boards.positions()[18:21].any())
    reset(client)
    client.move(RIGHT, goal="after")


def test_a_board_without_power_for_long_is_told_to_have_rebooted_when_it_is_back(
    client: Observer, boards: Simulation, motions: Motions
) -> None:
    client.move(MIDDLE)
    cut = time.time()
    boards.fault("power_cut", "can0/7")
    client.wait_fault("board-lost", cut, within=1.0)
    on = time.time()
    boards.fault("power_on", "can0/7")
    client.wait_fault("board-rebooted", on, within=1.0)
    reset(client)
    client.move(RIGHT, goal="after")


def test_all_boards_rebooting_are_told_and_one_reset_brings_them_back(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    running(client)
    rebooted = time.time()
    for board in board_names(arm):
        boards.fault("power_cut", board)
    for board in board_names(arm):
        boards.fault("power_on", board)
    client.wait_fault("board-rebooted", rebooted, within=1.0)
    aborted(client, "a", "can0/")
    told: Callable[[], bool] = lambda: (  # noqa: E731
        [s["code"] for s in client.heard["state"][-1]["faults"]].count("board-rebooted") == len(board_names(arm))
    )
    eventually(told)
    eventually(lambda: not boards.positions().any())
    reset(client)
    assert client.wait_now("ready")["measured"] == [0] * 48
    client.move(RIGHT, goal="after")


def test_inputs_that_come_later_than_the_actuator_may_take_are_a_stuck_actuator(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    """The board's inputs, and its answers when it is asked for them, are kept from the bus."""
    label, _ = first_to_switch(client, arm, RIGHT)
    node = wired(arm, label).node
    late = list[tuple[int, bytes]]()

    def answer(cob_id: int, data: bytes) -> list[tuple[int, bytes]]:
        if cob_id in (cia301.TPDO1 + node, cia301.SDO_ANSWER + node):
            late.append((cob_id, data))
            return []
        return [(cob_id, data)]

    with answering(boards, f"can0/{node}", answer):
        sent = time.time()
        assert client.goal(RIGHT, id="a")["accepted"]
        state = client.wait_fault("stuck", sent, within=1.0)
        aborted(client, "a", f"can0/{node}")
    assert f"can0/{node}" in state["reason"]
    assert late
    reset(client)
    assert client.wait_now("ready")["measured"] == boards.positions().astype(int).tolist()
    client.move(MIDDLE, goal="after")


def test_a_lost_word_of_the_inputs_is_asked_for(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    label, _ = first_to_switch(client, arm, RIGHT)
    node = wired(arm, label).node
    lost = list[bytes]()

    def answer(cob_id: int, data: bytes) -> list[tuple[int, bytes]]:
        if cob_id == cia301.TPDO1 + node:
            lost.append(data)
            return []
        return [(cob_id, data)]

    with answering(boards, f"can0/{node}", answer):
        client.move(RIGHT)
    assert lost
    assert client.wait_now("ready")["faults"] == []


@pytest.mark.parametrize("late", [True, False])
def test_a_board_that_answers_late_or_wrongly_at_start_is_named_and_brought_up_later(
    boards: Simulation, bench: Bench, timing: Timing, late: bool
) -> None:
    def answer(cob_id: int, data: bytes) -> list[tuple[int, bytes]]:
        if cob_id != cia301.SDO_ANSWER + 3:
            return [(cob_id, data)]
        return [] if late else [(cob_id, data[:1] + b"\x55\x55\x55" + data[4:])]  # of an object nobody asked for

    with answering(boards, "can0/3", answer):
        bench.run(replace(timing, boot_timeout=0.5 * SLOWNESS))
        client = bench.observer()
        state = client.wait_for("fault")
        assert "can0/3" in state["reason"]
        assert {fault["code"] for fault in state["faults"]} == {"board-missing"}
        answer = client.goal(MIDDLE)
        assert (answer["accepted"], "can0/3" in answer["message"]) == (False, True)
    client.wait_now("ready")  # by itself: the board is heard, and tried again
    client.move(MIDDLE)
    assert boards.switches().sum() == client.result("move")["switches"]


def test_inputs_of_a_wrong_length_are_told(client: Observer, boards: Simulation, motions: Motions) -> None:
    running(client)
    said = time.time()
    with boards.board("can0/4") as board:
        board.send_message(cia301.TPDO1 + 4, bytes(3))
    client.wait_fault("wrong-length", said, within=1.0)
    aborted(client, "a", "can0/4")
    reset(client)


@pytest.mark.parametrize(
    ("frame", "named"),
    [
        (cia301.frame(cia301.SYNC), "SYNC, frame 080h"),
        (cia301.frame(cia301.NMT, bytes([Command.START, 5])), "NMT, frame 000h"),
        (cia301.heartbeat(127, State.OPERATIONAL), "the master's heartbeat, frame 77Fh"),
        (cia301.frame(0x205, bytes([7])), "an RPDO, frame 205h"),
    ],
    ids=["SYNC", "NMT", "heartbeat", "RPDO"],
)
def test_another_master_is_told_by_its_frame_and_what_it_latched_switches_nothing(
    client: Observer, boards: Simulation, motions: Motions, bus: BusSettings, frame: can.Message, named: str
) -> None:
    running(client)
    before, sent = boards.switches().tolist(), time.time()
    with can.Bus(interface=bus.interface, channel=bus.channel, ignore_config=True) as other:
        other.send(frame)
    state = client.wait_fault("foreign-master", sent, within=1.0)
    assert named in state["reason"]
    aborted(client, "a", named)
    assert boards.switches().tolist() == before
    reset(client)
    client.move(RIGHT, goal="after")


def test_a_slow_actuator_is_stuck_when_it_is_late_and_ready_after_reset(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    label, _ = first_to_switch(client, arm, RIGHT)
    boards.fault("slow", label, 20)
    sent = time.time()
    assert client.goal(RIGHT, id="a")["accepted"]
    state = client.wait_fault("stuck", sent, within=1.0)
    assert label in state["reason"]
    aborted(client, "a", label)
    boards.fault("slow", label, 1)
    eventually(lambda: np.isin(boards.positions(), (0, 1)).all())
    reset(client)
    client.move(LEFT, goal="after")


def test_an_end_stop_that_bounces_is_borne_while_the_actuator_travels_and_told_when_it_rests(
    client: Observer, boards: Simulation, arm: Arm, motions: Motions
) -> None:
    label, now = first_to_switch(client, arm, RIGHT)
    node, bit = wired(arm, label).node, wired(arm, label).output

    def answer(cob_id: int, data: bytes) -> list[tuple[int, bytes]]:
        if cob_id != cia301.TPDO1 + node or data[0] >> bit & 1 == now:
            return [(cob_id, data)]
        return [(cob_id, data), (cob_id, bytes([data[0] ^ 1 << bit])), (cob_id, data)] * 3  # on arrival

    with answering(boards, f"can0/{node}", answer):
        client.move(RIGHT)
    client.move(MIDDLE, goal="back")
    rest = time.time() + bearing(arm).settle_margin + bearing(arm).travel_time
    eventually(lambda: time.time() > rest)
    assert client.wait_now("ready")["faults"] == []
    rattled = time.time()
    with boards.board(f"can0/{node}") as board:
        board.send_message(cia301.TPDO1 + board.node, bytes([board.objects.number(0x6000, 1) ^ 1 << bit]))
    state = client.wait_fault("unexpected-motion", rattled, within=1.0)
    assert label in state["reason"]
    reset(client)
    client.move(RIGHT, goal="after")
