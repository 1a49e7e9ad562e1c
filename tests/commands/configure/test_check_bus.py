"""The option --bus of the command check on simulated boards, over python-can's virtual bus."""

from __future__ import annotations

import json
import socket
import subprocess
import threading
from pathlib import Path

import can
import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.commands.configure.check import summary, wrong_rates
from hyperbit.controller.program import VERSION, Welcome, encode
from tests.commands.conftest import ARM

NAME = "checked-by-a-test"  # no executor of this computer has this name


@pytest.fixture
def arm(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    document = yaml.safe_load(ARM.read_text())
    document["name"] = NAME
    document["buses"][0] |= {"interface": "virtual", "channel": request.node.name}
    document["modules"][0]["count"] = 4
    document["actuators"] = [entry for entry in document["actuators"] if entry["module"] <= 4]
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture
def check(hyperbit, arm, tmp_path):
    return lambda *words: hyperbit("check", str(arm), "--bus", "--socket", str(tmp_path), *words)


def test_each_kind_of_answer_is_counted(check, boards, brief_listening):
    assert check()[0] == 0
    boards.fault("error", "can0/1", "2320")
    with boards.board("can0/2") as it:
        it.receive(0, bytes([2, 2]), it.now)
        it.objects.set_number(0x1017, 0, 100)
        it.supervision.begin(it.now)
    with boards.board("can0/3") as it:
        it.silent = True
    code, _, err = check()
    assert code == 1
    assert err == "1 board does not answer, 1 is stopped, 1 reports an error\n"
    code, out, _ = check("--json")
    told = json.loads(out)
    assert (code, [board["code"] for board in told["boards"]]) == (
        1,
        ["board-error", "board-stopped", "board-missing", ""],
    )


def test_the_count_is_a_sentence():
    codes = ["board-missing", "bus-down", "board-error", "wrong-device"]
    assert summary(codes) == (
        "2 boards do not answer, 1 reports an error, 1 lacks an object or value that hyperbit needs"
    )
    assert summary(["board-error"] * 4) == "4 boards report an error"
    assert summary(["sdo-refused"]) == "1 board refuses a value that hyperbit needs"


def test_an_executor_on_the_bus_is_refused_before_anything_is_sent(check, boards, request):
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        message = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        task = bus.send_periodic(message, 0.05)
        code, _, err = check()
        task.stop()
        sent = [received.arbitration_id for received in iter(lambda: bus.recv(0), None)]
    assert (code, "an executor is running (its heartbeat, node 127, is on can0): stop it first" in err) == (1, True)
    assert not [cob_id for cob_id in sent if cob_id & 0x780 in (0x580, 0x600)]


def test_an_executor_that_answers_at_its_socket_is_refused(check, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.bind(str(tmp_path / f"{NAME}.sock"))
        server.listen()

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.recv(65_536)
                client.send(encode(Welcome(VERSION, NAME, "", 1, (), 0)))

        threading.Thread(target=serve, daemon=True).start()
        code, _, err = check()
    assert (code, f"the executor of {NAME} is running (it answers at" in err) == (1, True)


@pytest.mark.parametrize("info", [{"bittiming": {"bitrate": 250_000}}, {"bittiming_bitrate": 250_000}])
def test_a_bus_with_another_bit_rate_than_the_files_is_told(monkeypatch, info):
    link = [{"linkinfo": {"info_data": info}}]  # drivers without bit timings, as of slcan, tell the rate alone
    done = subprocess.CompletedProcess((), 0, json.dumps(link).encode())
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    [(bus, text)] = wrong_rates(load(ARM))
    assert bus.name == "can0"
    where = "/etc/systemd/network/80-can0.network"
    assert text == f"can0 has 250000 bit/s, the arm's file 1000000: change {where} or the file"
    for nothing in (b"", b"[]", b"[{}]"):
        done.stdout = nothing
        assert not list(wrong_rates(load(ARM)))
