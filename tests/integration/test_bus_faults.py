"""The bus fails in every way SocketCAN has: it is told, nothing moves for it, and the arm is ready when it is back."""

import threading
import time
from contextlib import suppress

import can
import pytest

from controller.motion import codes
from drivers import cia301
from drivers.simulation.simulation import Simulation
from drivers.wiring import BusSettings
from tests import emulated, vcan
from tests.daemon.waiting import SLOWNESS, eventually
from tests.integration.harness import Observer
from tests.integration.motions import Motions
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT

CONTROLLER, PASSIVE, ACTIVE = 0x04, 0x20, 0x40  # class of an error frame and its details, from linux/can/error.h

pytestmark = pytest.mark.buses("emulated", "socketcan")


def running(client: Observer, goal: str = "a") -> None:
    """Sends a goal that is under way and would be for two hours."""
    client.move(MIDDLE, goal=f"{goal} before")
    assert client.goal(MIDDLE, RIGHT, LEFT, times=[0, HOUR, 2 * HOUR], id=goal)["accepted"]
    client.wait_for("executing", f"goal {goal}")


def aborted(client: Observer, goal: str, word: str) -> None:
    result = client.result(goal)
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert word in result["message"]


def ready_by_itself(client: Observer, boards: Simulation, since: float, *faults: str) -> None:
    """Waits until the arm is ready again, holds what was measured and takes a fresh goal."""

    def ready() -> dict | None:
        return next((s for s in client.heard["state"] if s["stamp"] > since and s["mode"] == "ready"), None)

    state = eventually(ready)
    assert state["faults"] == []
    assert state["goal"] is None
    assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
    client.move(RIGHT, goal="after")


@pytest.mark.parametrize("how", ["down", "deleted"])
def test_an_interface_that_goes_is_told_and_when_it_is_back_so_is_the_arm(
    interface: emulated.Interface | vcan.Interface, client: Observer, boards: Simulation, listener: can.BusABC, how: str
) -> None:
    running(client)
    switches, gone = boards.switches().tolist(), time.time()
    interface.down() if how == "down" else interface.delete()
    state = client.wait_fault("bus-down", gone, within=1.0)
    assert (state["mode"], state["goal"]) == ("fault", None)
    assert "can0" in state["reason"]
    aborted(client, "a", "can0")
    refused = client.goal(LEFT, id="b")
    assert (refused["accepted"], "can0" in refused["message"]) == (False, True)
    back = time.time()
    interface.up() if how == "down" else interface.make()
    eventually(lambda: [s for s in client.heard["state"] if s["stamp"] > back and s["mode"] == "ready"])
    assert boards.switches().tolist() == switches
    ready_by_itself(client, boards, back)
    assert [len(client.results(goal)) for goal in client.accepted] == [1] * len(client.accepted)


def test_after_bus_off_what_was_queued_switches_nothing(
    queue: emulated.Interface | vcan.Interface, client: Observer, boards: Simulation, motions: Motions
) -> None:
    client.move(MIDDLE, goal="before")
    queue.hold()  # so that what a goal sends is in the queue when the controller goes off
    assert client.goal(RIGHT, id="a")["accepted"]
    off = time.time()
    queue.bus_off()
    state = client.wait_fault("bus-off", off, within=1.0)
    assert state["mode"] == "fault"
    aborted(client, "a", "can0")
    assert client.result("a")["switches"] == 0
    before, back = boards.switches().tolist(), time.time()
    queue.restart()
    ready_by_itself(client, boards, back)
    assert boards.switches().tolist() != before, "by the goal after it"


def test_error_passive_is_told_and_the_arm_goes_on(
    interface: emulated.Interface | vcan.Interface, client: Observer, motions: Motions
) -> None:
    passive = time.time()
    interface.tell(CONTROLLER, PASSIVE, tx_errors=130, rx_errors=7)
    state = client.wait_fault("bus-passive", passive, within=1.0)
    assert state["mode"] == "ready"
    assert "130 errors" in state["faults"][0]["message"]

    def diagnosed() -> bool:
        buses = [it["buses"][0] for it in client.heard["diagnostics"]]
        return any((bus["state"], bus["tx_errors"], bus["rx_errors"]) == ("passive", 130, 7) for bus in buses)

    eventually(diagnosed)
    client.move(RIGHT)
    interface.tell(CONTROLLER, ACTIVE)
    eventually(lambda: not client.heard["state"][-1]["faults"])


def test_a_queue_that_stays_full_is_told_and_what_is_in_it_switches_nothing(
    queue: emulated.Interface | vcan.Interface, client: Observer, boards: Simulation, motions: Motions
) -> None:
    running(client)
    full = time.time()
    queue.hold()  # ten frames later sending fails with ENOBUFS
    client.wait_fault("bus-busy", full, within=1.0)
    aborted(client, "a", "can0")
    assert client.wait_now("fault")["goal"] is None
    back = time.time()
    queue.release()
    ready_by_itself(client, boards, back)


def test_a_goal_on_a_bus_that_takes_frames_and_lets_none_leave_switches_nothing(
    queue: emulated.Interface | vcan.Interface, client: Observer, boards: Simulation, motions: Motions
) -> None:
    client.move(MIDDLE, goal="before")
    queue.hold()
    full = time.time()
    assert client.goal(RIGHT, id="a")["accepted"]
    client.wait_fault("bus-busy", full, within=1.0)
    aborted(client, "a", "can0")
    assert client.result("a")["switches"] == 0
    back = time.time()
    queue.release()
    ready_by_itself(client, boards, back)


def test_a_bus_full_of_others_frames_does_not_stop_the_arm(
    interface: emulated.Interface | vcan.Interface,
    client: Observer,
    boards: Simulation,
    bus: BusSettings,
    motions: Motions,
) -> None:
    """Of low priority, so that ours still leave."""
    bitrate = 1_000_000 if SLOWNESS == 1 else 20_000  # of frames as the machine can take in
    if bounded := isinstance(interface, vcan.Interface) and not vcan.queueless():
        interface.bound(bitrate)
    ending, every = threading.Event(), 0.01 * SLOWNESS
    frames = round(bitrate / 135 * every)  # one of 8 bytes has up to 135 bits

    def flood() -> None:
        with can.Bus(interface=bus.interface, channel=bus.channel, ignore_config=True) as other:
            vcan.give_way(other, vcan.LAST)
            while not ending.wait(every):
                with suppress(can.CanOperationError):  # the queue is full, as it should be
                    for _ in range(frames):
                        other.send(cia301.frame(0x7E0, bytes(8)))

    flooding = threading.Thread(target=flood, daemon=True)
    flooding.start()
    try:
        for k in range(4):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
        full = (0.8 if bounded else 0.3) * bitrate / bus.bitrate
        eventually(lambda: any(it["buses"][0]["load"] > full for it in client.heard["diagnostics"]))
    finally:
        ending.set()
        flooding.join()
    assert client.wait_now("ready")["faults"] == []
