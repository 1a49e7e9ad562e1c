"""The commands board, check --bus, node-id and probe, on simulated boards over python-can's virtual bus."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
import yaml

from hyperbit.controller.commands.configure.check import summary
from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.program import BoardErrors, Goodbye, Up, Welcome, encode
from hyperbit.drivers.canopen.tools.lss import Lss
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.simulation import Simulation
from hyperbit.drivers.simulation.variants import VARIANTS, Variant
from tests.commands.conftest import ARM
from tests.waiting import eventually

NAME = "checked-by-a-test"  # no executor of this computer has this name
WELCOME = Welcome(NAME, "", 1, (), 0)
MASTER = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
RUNNING = "an executor is running (its heartbeat, node 127, is on {}): stop it first"
IDENTITY = "0x0:0x191:0x1:0x69"


@pytest.fixture
def channel(request: pytest.FixtureRequest) -> str:
    return str(request.node.name)


@pytest.fixture
def arm(tmp_path: Path, channel: str) -> Path:
    """The file of an arm with eight boards."""
    document = yaml.safe_load(ARM.read_text()) | {"name": NAME}
    document["buses"][0] |= {"interface": "virtual", "channel": channel}
    document["boards"]["boot_timeout"] = 60
    document["modules"][0]["count"] = 8
    document["actuators"] = [entry for entry in document["actuators"] if entry["module"] <= 8]
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture
def boards(arm: Path) -> Iterator[Simulation]:
    read = read_arm(arm)
    with simulated(read.wiring, read.timing) as boards:
        yield boards


@contextlib.contextmanager
def simulated(wiring: Wiring, timing: Timing, **more: object) -> Iterator[Simulation]:
    simulation = Simulation(wiring, timing, **more)
    simulation.start()
    yield simulation
    simulation.stop()


@contextlib.contextmanager
def nodes(channel: str, variants: dict[int, Variant]) -> Iterator[Simulation]:
    """Boards with these node ids."""
    channels = tuple(Channel(str(node), "can0", node, 0, 0) for node in variants)
    wiring = Wiring((BusWiring("can0", "virtual", channel),), channels)
    with simulated(wiring, Timing(), variants={f"can0/{node}": it for node, it in variants.items()}) as boards:
        yield boards


def numbered(channel: str, *ids: int) -> contextlib.AbstractContextManager[Simulation]:
    """Boards whose serial number is the node id plus 100."""
    return nodes(channel, {node: Variant("numbered", stored={(0x1018, 4): 100 + node}) for node in ids})


@contextlib.contextmanager
def master(channel: str) -> Iterator[can.BusABC]:
    """An executor on the bus; afterwards nothing must have been sent to a board."""
    with can.Bus(interface="virtual", channel=channel) as bus:
        task = bus.send_periodic(MASTER, 0.05)
        yield bus
        task.stop()
        sent = [received.arbitration_id for received in iter(lambda: bus.recv(0), None)]
    assert not [cob_id for cob_id in sent if cob_id & 0x780 in (0x580, 0x600)]


@contextlib.contextmanager
def executor(folder: Path, *answers: Up) -> Iterator[None]:
    """An executor that answers the first client."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.bind(str(folder / f"{NAME}.sock"))
        server.listen()

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.recv(65_536)
                for answer in answers:
                    client.send(encode(answer))
                while client.recv(65_536):
                    pass

        threading.Thread(target=serve, daemon=True).start()
        yield


@pytest.fixture
def board(hyperbit, arm, tmp_path) -> Callable[..., tuple[int, str, str]]:
    return lambda *words: hyperbit("board", str(arm), *words, "--socket", str(tmp_path))


@pytest.fixture
def check(hyperbit, arm, tmp_path) -> Callable[..., tuple[int, str, str]]:
    return lambda *words: hyperbit("check", str(arm), "--bus", "--socket", str(tmp_path), *words)


def test_errors_are_read_by_the_executor_that_runs(board, tmp_path):
    told = BoardErrors(1, "", 0x01, (0x1B00_0000, 0x1B11_8130, 0x3001_5000))
    with executor(tmp_path, WELCOME, told):
        assert board("can0/5", "errors") == (
            0,
            "1001h = 01h\n"
            "1003h: 3 entries\n"
            "1B000000h no error (0000h)\n"
            "1B118130h heartbeat of the master lost (8130h), has ended\n"
            "30015000h device hardware (5000h)\n",
            "",
        )


STOPPED, OTHER = "board can0/5 is stopped", Goodbye("of another version")


@pytest.mark.parametrize(
    ("answers", "words", "sentence"),
    [
        ((WELCOME, BoardErrors(1, STOPPED)), ("board", "can0/5", "errors"), STOPPED),
        ((WELCOME, Goodbye(STOPPED)), ("board", "can0/5", "errors"), STOPPED),
        ((WELCOME,), ("board", "can0/5", "reset", "--yes"), f"the executor of {NAME} is running"),
        ((OTHER,), ("board", "can0/5", "reset", "--yes"), f"the executor of {NAME} is running"),
        ((WELCOME,), ("check", "--bus"), f"the executor of {NAME} is running (it answers at"),
    ],
)
def test_an_executor_that_runs_is_asked_or_bars_the_command(hyperbit, arm, tmp_path, answers, words, sentence):
    with executor(tmp_path, *answers):
        code, _, err = hyperbit(words[0], str(arm), *words[1:], "--socket", str(tmp_path))
    assert (code, sentence in err) == (1, True), err


def test_errors_are_read(board, boards, tmp_path, brief_listening):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as old:  # nobody serves it
        old.bind(str(tmp_path / f"{NAME}.sock"))
    boards.fault("error", "can0/5", "2320")
    code, out, err = board("can0/5", "errors")
    first, second, third = out.splitlines()
    assert (code, err, first[:9], second) == (0, "", "1001h = 0", "1003h: 1 entries")
    assert third.endswith("2320h output short circuit (2320h)")
    code, out, _ = board("can0/5", "errors", "--json")
    told = json.loads(out)
    assert (code, told["board"], told["history"][0] & 0xFFFF) == (0, "can0/5", 0x2320)


@pytest.mark.parametrize(
    ("options", "question", "outputs_kept"),
    [((), "its actuators may move", False), (("--communication",), "may switch the outputs", True)],
)
def test_a_reset_is_asked_for_and_waits_for_the_boot_up_message(
    board, boards, monkeypatch, brief_listening, options, question, outputs_kept
):
    boards.fault("error", "can0/5", "2320")
    with boards.board("can0/5") as it:
        it.objects.set_number(0x1017, 0, 777)
        it.objects.set_number(0x6207, 1, 0x01)
    monkeypatch.setattr("typer.confirm", lambda asked, err: question in asked and False)
    code, _, err = board("can0/5", "reset", *options)
    assert (code, "nothing was reset" in err) == (1, True)
    with boards.board("can0/5") as it:
        assert it.objects.number(0x1017) == 777
    code, out, _ = board("can0/5", "reset", "--yes", *options)
    assert (code, out.startswith("board can0/5 has booted after ")) == (0, True)
    with boards.board("can0/5") as it, boards.board("can0/6") as other:
        assert it.objects.number(0x1017) == 0
        assert (it.objects.number(0x6207, 1) == 0x01) == outputs_kept
        assert other.objects.number(0x1000)
    if outputs_kept:
        assert board("can0/5", "errors")[1] == "1001h = 00h\n1003h: empty\n"


def test_a_missing_board_is_reported(board, arm, brief_listening):
    arm.write_text(arm.read_text().replace("boot_timeout: 60", "boot_timeout: 0.2"))
    code, _, err = board("can0/5", "errors")
    assert (code, "board can0/5 does not answer" in err) == (1, True)
    code, _, err = board("can0/5", "reset", "--yes")
    assert (code, "no boot-up message within 0.2 s (boards.boot_timeout)" in err) == (1, True)


def stop(boards: Simulation, node: int) -> None:
    """Stops a board as after the end of an executor."""
    with boards.board(f"can0/{node}") as it:
        it.objects.set_number(0x1017, 0, 100)
        it.receive(0, bytes([0x80, node]), it.now)
        it.supervision.begin(it.now)
        it.receive(0, bytes([0x02, node]), it.now)


def test_a_stopped_board_is_said_to_be_stopped(board, boards, brief_listening):
    stop(boards, 5)
    code, _, err = board("can0/5", "errors")
    assert (code, err.startswith("board can0/5 is stopped, as after the end of an executor")) == (1, True), err
    assert board("can0/5", "reset", "--yes")[0] == 0
    assert board("can0/5", "errors")[0] == 0


def test_an_executor_that_starts_during_the_question_is_noticed(board, boards, channel, monkeypatch, brief_listening):
    with boards.board("can0/5") as it:
        it.objects.set_number(0x1017, 0, 777)
    with can.Bus(interface="virtual", channel=channel) as bus:
        tasks = []
        monkeypatch.setattr("typer.confirm", lambda question, err: not tasks.append(bus.send_periodic(MASTER, 0.05)))
        code, _, err = board("can0/5", "reset")
        tasks[0].stop()
    assert (code, "an executor is running" in err) == (1, True)
    with boards.board("can0/5") as it:
        assert it.objects.number(0x1017) == 777


def test_commands_refuse_a_bus_with_a_master_before_anything_is_sent(hyperbit, board, check, boards, channel):
    words = channel, "--interface", "virtual"
    with master(channel):
        for code, out, err in (
            board("can0/5", "reset", "--yes"),
            check(),
            hyperbit("probe", *words),
            hyperbit("node-id", channel, "7", *words[1:]),
        ):
            assert (code, out) == (1, "")
            assert RUNNING.format("can0") in err or RUNNING.format(channel) in err
    with boards.board("can0/5") as it:
        assert it.lss.stored == (5, 0)


def test_each_kind_of_answer_is_counted(check, boards, brief_listening):
    assert check()[0] == 0
    boards.fault("error", "can0/1", "2320")
    stop(boards, 2)
    with boards.board("can0/3") as it:
        it.silent = True
    code, _, err = check()
    assert (code, err) == (1, "1 board does not answer, 1 is stopped, 1 reports an error\n")
    code, out, _ = check("--json")
    codes = [board["code"] for board in json.loads(out)["boards"]]
    assert (code, codes) == (1, ["board-error", "board-stopped", "board-missing", *[""] * 5])


def test_the_count_is_a_sentence():
    lacks = "2 boards do not answer, 1 reports an error, 1 lacks an object or value that hyperbit needs"
    assert summary(["board-missing", "bus-down", "board-error", "wrong-device"]) == lacks
    assert summary(["board-error"] * 4) == "4 boards report an error"
    assert summary(["sdo-refused"]) == "1 board refuses a value that hyperbit needs"


@pytest.fixture
def set_id(hyperbit, channel) -> Callable[..., tuple[int, str, str]]:
    return lambda *words: hyperbit("node-id", channel, "--interface", "virtual", *words)


def test_the_only_board_gets_another_id_and_bit_rate(set_id, channel, brief_listening):
    with numbered(channel, 5) as boards:
        assert set_id("7", "--new-bitrate", "250000") == (
            0,
            f"board {IDENTITY}: stored node id 7 (before: 5) and 250000 bit/s\n"
            f"switch its supply off and on, then: hyperbit probe {channel} --bitrate 250000 --interface virtual\n",
            "",
        )
        with boards.board("can0/5") as board:
            assert board.lss.stored == (7, 3)
        eventually(lambda: not board.lss.state)


def test_a_value_that_was_not_stored_is_not_reported(set_id, channel, brief_listening):
    with numbered(channel, 5):
        _, out, _ = set_id("7", "--bitrate", "500000")
        assert out.startswith(f"board {IDENTITY}: stored node id 7 (before: 5)\n")
        _, out, _ = set_id("--new-bitrate", "250000", "--json")
        assert json.loads(out) == {"identity": IDENTITY, "before": 5, "node": 5, "bitrate": 250000}
        assert json.loads(set_id("7", "--json")[1])["bitrate"] is None


def test_the_board_is_released_if_the_command_is_terminated(set_id, channel, monkeypatch, brief_listening):
    with numbered(channel, 5) as boards:
        monkeypatch.setattr(Lss, "configure", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
        assert set_id("7")[0] == 143
        with boards.board("can0/5") as board:
            assert board.lss.stored == (5, 0)
        eventually(lambda: not board.lss.state)


def test_one_of_two_is_named(set_id, channel, brief_listening):
    with numbered(channel, 5, 9) as boards:
        code, _, err = set_id("7")
        assert (code, "nodes 5, 9 are on" in err, "--board" in err) == (1, True, True)
        code, _, err = set_id("9", "--board", "0:401:1:105")
        assert (code, "node id 9 is taken" in err) == (1, True)
        code, out, _ = set_id("7", "--board", "0:401:1:109", "--json")
        assert (code, json.loads(out)["before"]) == (0, 9)
        with boards.board("can0/5") as five, boards.board("can0/9") as nine:
            assert (five.lss.stored, nine.lss.stored) == ((5, 0), (7, 0))


def test_a_probe_tells_each_node(hyperbit, channel, brief_listening):
    words = ("probe", channel, "--interface", "virtual")
    code, out, err = hyperbit(*words)
    assert (code, out) == (1, "")
    assert f"no node answers on {channel} (virtual): check power, cable, termination and bit rate" in err
    with nodes(channel, {5: VARIANTS["standard"], 9: VARIANTS["guarding-only"]}) as boards:
        boards.fault("error", "can0/9", "2320")
        code, out, _ = hyperbit(*words)
        first, second = out.split(f"{channel}/9\n")
        assert (code, first.startswith(f"{channel}/5\n")) == (0, True)
        for line in (
            "type             1000h = 00030191h: CiA 401, digital inputs, digital outputs",
            "outputs          64 bits in 6200h; RPDO1 bits 0 to 63",
            "RPDO1            enabled, COB-ID 00000205h, transmission type 255, maps 62000108h 62000208h",
            "errors           1001h = 00h; 1003h: empty",
            "1017h = 0000h, no heartbeat",
            "1029h sub 1 = 00h, pre-operational",
            "identity         1018h: vendor 00000000h, product 00000191h, revision 00000001h, serial 00000000h",
        ):
            assert line in first
        assert "no 1016h (heartbeat consumer); no 1017h; 100Ch = 0000h, guard time 0 ms" in second
        assert "output short circuit (2320h)" in second
        five, nine = (json.loads(line) for line in hyperbit(*words, "--json")[1].splitlines())
        assert (five["node"], nine["node"], "1017h:0" in nine["objects"]) == (5, 9, False)
        assert (five["objects"]["1000h:0"], five["pdos"]["RPDO1"]["mapping"][0]) == (0x00030191, "62000108h")
        with boards.board("can0/9") as it:
            it.receive(0, bytes([2, 9]), it.now)
        assert f"board {channel}/9 is stopped, as after the end of an executor" in hyperbit(*words)[1]
