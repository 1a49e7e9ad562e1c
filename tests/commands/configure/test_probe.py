"""The command probe on simulated boards, over python-can's virtual bus."""

from __future__ import annotations

import json

import can
import pytest

from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.simulation import Simulation
from hyperbit.drivers.simulation.variants import VARIANTS

CHANNEL = "test_commands_probe"


@pytest.fixture
def boards():
    """Runs boards 5 and 9; board 9 differs from the standard."""
    settings = BusWiring("can0", "virtual", CHANNEL)
    channels = (Channel("a", "can0", 5, 0, 0), Channel("b", "can0", 9, 0, 0))
    simulation = Simulation(Wiring((settings,), channels), Timing(), variants={"can0/9": VARIANTS["guarding-only"]})
    simulation.start()
    yield simulation
    simulation.stop()


def test_each_node_has_its_rows(hyperbit, boards, brief_listening):
    boards.fault("error", "can0/9", "2320")
    code, out, _ = hyperbit("probe", CHANNEL, "--interface", "virtual")
    assert code == 0
    first, second = out.split(f"{CHANNEL}/9\n")
    assert first.startswith(f"{CHANNEL}/5\n")
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


def test_json_has_all_that_was_read(hyperbit, boards, brief_listening):
    code, out, _ = hyperbit("probe", CHANNEL, "--interface", "virtual", "--json")
    assert code == 0
    five, nine = (json.loads(line) for line in out.splitlines())
    assert (five["node"], nine["node"]) == (5, 9)
    assert five["objects"]["1000h:0"] == 0x00030191
    assert "1017h:0" not in nine["objects"]
    assert five["pdos"]["RPDO1"]["mapping"][0] == "62000108h"


def test_a_bus_with_an_executor_is_refused_before_anything_is_sent(hyperbit, boards):
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        message = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        task = bus.send_periodic(message, 0.05)
        code, out, err = hyperbit("probe", CHANNEL, "--interface", "virtual")
        task.stop()
        sent = [received.arbitration_id for received in iter(lambda: bus.recv(0), None)]
    assert (code, out) == (1, "")
    assert f"an executor is running (its heartbeat, node 127, is on {CHANNEL}): stop it first" in err
    assert not [cob_id for cob_id in sent if cob_id & 0x780 in (0x580, 0x600)]


def test_a_stopped_node_is_said_to_be_stopped(hyperbit, boards, brief_listening):
    with boards.board("can0/9") as it:
        it.receive(0, bytes([2, 9]), it.now)
    code, out, _ = hyperbit("probe", CHANNEL, "--interface", "virtual")
    assert code == 0
    assert f"board {CHANNEL}/9 is stopped, as after the end of an executor" in out


def test_a_bit_rate_that_socketcan_would_ignore_is_refused(hyperbit):
    code, out, err = hyperbit("probe", "can0", "--bitrate", "250000")
    assert (code, out) == (2, "")
    assert "sudo ip link set can0 up type can bitrate 250000" in " ".join(err.split())


def test_a_bus_without_nodes_fails_in_words(hyperbit, brief_listening):
    code, out, err = hyperbit("probe", "test_nobody", "--interface", "virtual")
    assert (code, out) == (1, "")
    assert "no node answers on test_nobody (virtual): check power, cable, termination and bit rate" in err


def test_a_missing_bus_fails_with_a_message(hyperbit):
    code, _, err = hyperbit("probe", "can99")
    assert code == 1
    assert "check that can99 is up and that its --interface is socketcan" in err
