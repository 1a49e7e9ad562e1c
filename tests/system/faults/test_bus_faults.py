"""The bus fails as SocketCAN buses do: the fault is reported, nothing moves, and the arm recovers with the bus."""

import threading
import time
from contextlib import suppress

import can
import pytest

from hyperbit.drivers.simulation.simulation import Simulation
from tests import emulated, vcan
from tests.system.faults.test_faults import aborted, ready_by_itself, running
from tests.system.stack.arms import QUICK
from tests.system.stack.observer import Observer
from tests.system.stack.places import LEFT, MIDDLE, RIGHT, other_place
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

CONTROLLER, PASSIVE, ACTIVE = 0x04, 0x20, 0x40  # class of an error frame and its details, from linux/can/error.h

Interface = emulated.Interface | vcan.Interface

pytestmark = pytest.mark.arm(boards=QUICK)


@pytest.fixture
def queue(interface: Interface) -> Interface:
    if isinstance(interface, vcan.Interface) and (reason := vcan.queueless()):
        pytest.skip(reason)
    return interface


@pytest.mark.parametrize("how", ["down", "deleted"])
def test_an_interface_that_goes_is_told_and_when_it_is_back_so_is_the_arm(
    interface: Interface, client: Observer, boards: Simulation, how: str
) -> None:
    running(client)
    switches, gone = boards.switches().tolist(), time.time()
    interface.down() if how == "down" else interface.delete()
    state = client.wait_fault("bus-down", gone)
    assert (state["mode"], "can0" in state["reason"]) == ("fault", True)
    aborted(client, "a", "can0")
    eventually(lambda: client.state["goal"] is None)
    refused = client.goal(LEFT, id="b")
    assert (refused["accepted"], "can0" in refused["message"]) == (False, True)
    back = time.time()
    interface.up() if how == "down" else interface.make()
    eventually(lambda: [s for s in client.heard["state"] if s["stamp"] > back and s["mode"] == "ready"])
    assert boards.switches().tolist() == switches
    ready_by_itself(client, boards, back)


def test_after_bus_off_what_was_queued_switches_nothing(
    queue: Interface, client: Observer, boards: Simulation, system: System
) -> None:
    client.move(MIDDLE, goal="before")
    goal = other_place(client, system.arm)
    queue.hold()  # so that the goal's frames are in the queue at the bus-off
    assert client.goal(goal, id="a")["accepted"]
    off = time.time()
    queue.bus_off()
    assert client.wait_fault("bus-off", off)["mode"] == "fault"
    aborted(client, "a", "can0")
    assert client.result("a")["switches"] == 0
    before, back = boards.switches().tolist(), time.time()
    queue.restart()
    ready_by_itself(client, boards, back)
    assert boards.switches().tolist() != before, "by the goal after it"


def test_error_passive_is_told_and_the_arm_goes_on(interface: Interface, client: Observer) -> None:
    passive = time.time()
    interface.tell(CONTROLLER, PASSIVE, tx_errors=130, rx_errors=7)
    state = client.wait_fault("bus-passive", passive)
    assert state["mode"] == "ready"
    assert "130 transmit" in state["faults"][0]["message"]

    def diagnosed() -> bool:
        buses = [it["buses"][0] for it in client.heard["diagnostics"] if it["buses"]]
        return any((bus["state"], bus["tx_errors"], bus["rx_errors"]) == ("passive", 130, 7) for bus in buses)

    eventually(diagnosed)
    client.move(RIGHT)
    interface.tell(CONTROLLER, ACTIVE)
    eventually(lambda: not client.codes)


@pytest.mark.parametrize("moving", [True, False], ids=["a goal is sent", "a goal rests"])
def test_a_queue_that_stays_full_is_told_and_what_is_in_it_switches_nothing(
    queue: Interface, client: Observer, boards: Simulation, system: System, moving: bool
) -> None:
    running(client)
    goal = other_place(client, system.arm) if moving else MIDDLE
    full = time.time()
    queue.hold()  # ten frames later sending fails with ENOBUFS
    if moving:
        assert client.goal(goal, id="b")["accepted"]
    client.wait_fault("bus-busy", full)
    aborted(client, "b" if moving else "a", "can0")
    assert client.wait_now("fault")["goal"] is None
    back = time.time()
    queue.release()
    ready_by_itself(client, boards, back)


@pytest.mark.arm(boards={"settle_margin": 10.0})
def test_a_bus_full_of_others_frames_does_not_stop_the_arm(
    interface: Interface, client: Observer, system: System
) -> None:
    """Frames of low priority, so that ours are still sent."""
    bitrate, load = (250_000, 0.05) if SLOWNESS == 1 else (20_000, 0.005)  # as many frames as the machine can read
    if isinstance(interface, vcan.Interface) and not vcan.queueless():
        interface.bound(bitrate)
    ending, every = threading.Event(), 0.01 * SLOWNESS
    frames = round(bitrate / 135 * every)  # one of 8 bytes has up to 135 bits
    busy = can.Message(arbitration_id=0x7E0, data=bytes(8), is_extended_id=False)

    def flood() -> None:
        with can.Bus(interface=system.bus.interface, channel=system.bus.channel, ignore_config=True) as other:
            vcan.give_way(other, vcan.LAST)
            while not ending.wait(every):
                with suppress(can.CanOperationError):  # the queue is full, as intended
                    for _ in range(frames):
                        other.send(busy)

    flooding = threading.Thread(target=flood, daemon=True)
    flooding.start()
    try:
        for k in range(4):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
        eventually(lambda: any(it["buses"][0]["load"] > load for it in client.heard["diagnostics"] if it["buses"]))
    finally:
        ending.set()
        flooding.join()
    assert client.wait_now("ready")["faults"] == []
