"""The command node-id on simulated boards, over python-can's virtual bus."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator

import can
import pytest

from hyperbit.drivers.canopen.tools.lss import Lss
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.simulation import Simulation
from hyperbit.drivers.simulation.variants import Variant
from tests.waiting import eventually

CHANNEL = "test_commands_node_id"
SET = ("node-id", CHANNEL, "7", "--interface", "virtual")


@pytest.fixture
def run() -> Iterator[Callable[..., Simulation]]:
    """Runs boards with given node ids; the serial number is the node id plus 100."""
    running: list[Simulation] = []

    def start(*nodes: int) -> Simulation:
        settings = BusWiring("can0", "virtual", CHANNEL)
        channels = tuple(Channel(str(node), "can0", node, 0, 0) for node in nodes)
        variants = {f"can0/{node}": Variant("numbered", stored={(0x1018, 4): 100 + node}) for node in nodes}
        running.append(Simulation(Wiring((settings,), channels), Timing(), variants=variants))
        running[-1].start()
        return running[-1]

    yield start
    for simulation in running:
        simulation.stop()


def test_the_only_board_gets_another_id_and_bit_rate(hyperbit, run, brief_listening):
    boards = run(5)
    code, out, err = hyperbit(*SET, "--new-bitrate", "250000")
    assert (code, err) == (0, "")
    assert out == (
        "board 0x0:0x191:0x1:0x69: stored node id 7 (before: 5) and 250000 bit/s\n"
        f"switch its supply off and on, then: hyperbit probe {CHANNEL} --bitrate 250000 --interface virtual\n"
    )
    with boards.board("can0/5") as board:
        assert board.lss.stored == (7, 3)
    eventually(lambda: not board.lss.state)


def test_a_value_that_was_not_stored_is_not_reported(hyperbit, run, brief_listening):
    run(5)
    _, out, _ = hyperbit(*SET, "--bitrate", "500000")
    assert out.startswith("board 0x0:0x191:0x1:0x69: stored node id 7 (before: 5)\n")
    _, out, _ = hyperbit("node-id", CHANNEL, "--interface", "virtual", "--new-bitrate", "250000", "--json")
    assert json.loads(out) == {"identity": "0x0:0x191:0x1:0x69", "before": 5, "node": 5, "bitrate": 250000}
    _, out, _ = hyperbit(*SET, "--json")
    assert json.loads(out)["bitrate"] is None


def test_the_board_is_released_if_the_command_is_terminated(hyperbit, run, monkeypatch, brief_listening):
    boards = run(5)
    monkeypatch.setattr(Lss, "configure", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    code, _, _ = hyperbit(*SET)
    assert code == 143
    with boards.board("can0/5") as board:
        assert board.lss.stored == (5, 0)
    eventually(lambda: not board.lss.state)


def test_one_of_two_is_named(hyperbit, run, brief_listening):
    boards = run(5, 9)
    code, _, err = hyperbit(*SET)
    assert (code, "nodes 5, 9 are on" in err, "--board" in err) == (1, True, True)
    code, out, _ = hyperbit(*SET, "--board", "0:401:1:109", "--json")
    assert (code, json.loads(out)["before"]) == (0, 9)
    with boards.board("can0/5") as five, boards.board("can0/9") as nine:
        assert (five.lss.stored, nine.lss.stored) == ((5, 0), (7, 0))


def test_an_id_that_another_board_has_is_refused(hyperbit, run, brief_listening):
    run(5, 7)
    code, _, err = hyperbit(*SET, "--board", "0:401:1:105")
    assert (code, "node id 7 is taken" in err) == (1, True)


def test_the_node_id_is_not_set_while_a_master_is_on_the_bus(hyperbit, run):
    boards = run(5)
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        message = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        task = bus.send_periodic(message, 0.05)
        time.sleep(0.1)
        code, _, err = hyperbit(*SET)
        task.stop()
    assert (code, "an executor is running (its heartbeat" in err) == (1, True)
    with boards.board("can0/5") as board:
        assert board.lss.stored == (5, 0)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "give a node id, --new-bitrate or both; or --list alone"),
        (("5", "--list"), "or --list alone"),
        (("127",), "127: a board's node id is 1 to 126"),
        (("5", "--new-bitrate", "33"), "33 is not one of 10000, 20000"),
        (("5", "--board", "1:2:3"), "'1:2:3': four numbers are needed, VENDOR:PRODUCT:REVISION:SERIAL"),
        (("5", "--board", "a:2:3:4"), "four numbers are needed"),
    ],
)
def test_words_that_make_no_sense_are_unusable_input(hyperbit, words, sentence):
    code, _, err = hyperbit("node-id", CHANNEL, *words, "--interface", "virtual")
    assert (code, sentence in err) == (2, True)
