"""The command board on simulated boards, over python-can's virtual bus."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
import yaml

from hyperbit.controller.program import VERSION, BoardErrors, Goodbye, Up, Welcome, encode
from tests.commands.conftest import ARM


@pytest.fixture
def arm(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    document = yaml.safe_load(ARM.read_text())
    document["buses"][0] |= {"interface": "virtual", "channel": request.node.name}
    document["boards"]["boot_timeout"] = 60
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture
def board(hyperbit, arm, tmp_path):
    return lambda *words: hyperbit("board", str(arm), *words, "--socket", str(tmp_path))


@contextlib.contextmanager
def executor(folder: Path, *answers: Up) -> Iterator[None]:
    """An executor that answers the first client."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.bind(str(folder / "planar16.sock"))
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


WELCOME = Welcome(VERSION, "planar16", "", 1, (), 0)


def test_errors_are_read_by_the_executor_that_runs(board, tmp_path):
    told = BoardErrors(1, "", 0x01, (0x1B00_0000, 0x1B11_8130, 0x3001_5000))
    with executor(tmp_path, WELCOME, told):
        code, out, err = board("can0/5", "errors")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "1001h = 01h",
        "1003h: 3 entries",
        "1B000000h no error (0000h)",
        "1B118130h heartbeat of the master lost (8130h), has ended",
        "30015000h device hardware (5000h)",
    ]


@pytest.mark.parametrize("answer", [BoardErrors(1, "board can0/5 is stopped"), Goodbye("board can0/5 is stopped")])
def test_an_executor_that_cannot_read_errors_says_why(board, tmp_path, answer):
    with executor(tmp_path, WELCOME, answer):
        code, _, err = board("can0/5", "errors")
    assert (code, "board can0/5 is stopped" in err) == (1, True)


def test_a_reset_of_communication_clears_the_history_and_keeps_other_objects(
    board, boards, monkeypatch, brief_listening
):
    boards.fault("error", "can0/5", "2320")
    with boards.board("can0/5") as it:
        it.objects.set_number(0x1017, 0, 777)
        it.objects.set_number(0x6207, 1, 0x01)
    monkeypatch.setattr("typer.confirm", lambda question, err: "may switch the outputs" in question and False)
    assert board("can0/5", "reset", "--communication")[0] == 1
    code, out, _ = board("can0/5", "reset", "--communication", "--yes")
    assert (code, out.startswith("board can0/5 has booted after ")) == (0, True)
    with boards.board("can0/5") as it:
        assert (it.objects.number(0x1017), it.objects.number(0x6207, 1)) == (0, 0x01)
    assert board("can0/5", "errors")[1].splitlines() == ["1001h = 00h", "1003h: empty"]


def test_errors_are_read(board, boards, brief_listening):
    boards.fault("error", "can0/5", "2320")
    code, out, err = board("can0/5", "errors")
    assert (code, err) == (0, "")
    first, second, third = out.splitlines()
    assert (first[:9], second) == ("1001h = 0", "1003h: 1 entries")
    assert third.endswith("2320h output short circuit (2320h)")
    code, out, _ = board("can0/5", "errors", "--json")
    told = json.loads(out)
    assert (code, told["board"], told["history"][0] & 0xFFFF) == (0, "can0/5", 0x2320)


def test_a_reset_is_asked_for_and_waits_for_the_boot_up_message(board, boards, monkeypatch, brief_listening):
    with boards.board("can0/5") as it:
        it.objects.set_number(0x1017, 0, 777)
    monkeypatch.setattr("typer.confirm", lambda question, err: "its actuators may move" in question and False)
    code, _, err = board("can0/5", "reset")
    assert (code, "nothing was reset" in err) == (1, True)
    with boards.board("can0/5") as it:
        assert it.objects.number(0x1017) == 777
    code, out, _ = board("can0/5", "reset", "--yes")
    assert (code, out.startswith("board can0/5 has booted after ")) == (0, True)
    with boards.board("can0/5") as it, boards.board("can0/6") as other:
        assert it.objects.number(0x1017) == 0
        assert other.objects.number(0x1000)


def test_a_missing_board_is_reported(board, arm, brief_listening):
    arm.write_text(arm.read_text().replace("boot_timeout: 60", "boot_timeout: 0.2"))
    code, _, err = board("can0/5", "errors")
    assert (code, "board can0/5 does not answer" in err) == (1, True)
    code, _, err = board("can0/5", "reset", "--yes")
    assert (code, "no boot-up message within 0.2 s (boards.boot_timeout)" in err) == (1, True)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [(("can0/99", "errors"), "'can0/99' is no board of"), (("can0/5", "restart"), "'restart' is not one of")],
)
def test_a_missing_file_is_unusable_input(board, words, sentence):
    code, _, err = board(*words)
    assert (code, sentence in err) == (2, True), err


@pytest.mark.parametrize("answer", [WELCOME, Goodbye("of another version")])
def test_a_reset_is_refused_while_the_executor_runs(board, tmp_path, answer):
    with executor(tmp_path, answer):
        code, _, err = board("can0/5", "reset", "--yes")
    assert (code, "the executor of planar16 is running" in err) == (1, True)


def test_a_stopped_board_is_said_to_be_stopped(board, boards, brief_listening):
    with boards.board("can0/5") as it:
        it.objects.set_number(0x1017, 0, 100)
        it.receive(0, bytes([0x80, 5]), it.now)
        it.supervision.begin(it.now)
        it.receive(0, bytes([0x02, 5]), it.now)
    code, _, err = board("can0/5", "errors")
    assert (code, err.startswith("board can0/5 is stopped, as after the end of an executor")) == (1, True), err
    assert board("can0/5", "reset", "--yes")[0] == 0
    assert board("can0/5", "errors")[0] == 0


def test_a_socket_that_nobody_serves_does_not_count(board, boards, tmp_path, brief_listening):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as old:
        old.bind(str(tmp_path / "planar16.sock"))
    assert board("can0/5", "errors")[0] == 0


def test_the_command_refuses_while_a_master_is_on_the_bus(board, boards, request):
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        message = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        task = bus.send_periodic(message, 0.05)
        code, _, err = board("can0/5", "reset", "--yes")
        task.stop()
    assert (code, "an executor is running (its heartbeat, node 127, is on can0): stop it first" in err) == (1, True)


def test_an_executor_that_starts_during_the_question_is_noticed(board, boards, request, monkeypatch, brief_listening):
    with boards.board("can0/5") as it:
        it.objects.set_number(0x1017, 0, 777)
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        message = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        tasks = []
        monkeypatch.setattr("typer.confirm", lambda question, err: not tasks.append(bus.send_periodic(message, 0.05)))
        code, _, err = board("can0/5", "reset")
        tasks[0].stop()
    assert (code, "an executor is running" in err) == (1, True)
    with boards.board("can0/5") as it:
        assert it.objects.number(0x1017) == 777
