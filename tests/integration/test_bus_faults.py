"""The bus fails in every way SocketCAN has: it is told, nothing moves for it, and the arm is ready when it is back."""

import threading
import time

import can
import pytest

from controller.motion import codes
from drivers import cia301
from drivers.simulation import Simulation
from tests import emulated, vcan
from tests.daemon.waiting import eventually
from tests.integration.harness import Observer
from tests.integration.motions import Motions
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT

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


@pytest.mark.buses("emulated")
def test_after_bus_off_what_was_queued_switches_nothing(
    emulation: emulated.Interface, client: Observer, boards: Simulation, motions: Motions
) -> None:
    client.move(MIDDLE, goal="before")
    emulation.hold()  # so that what a goal sends is in the queue when the controller goes off
    assert client.goal(RIGHT, id="a")["accepted"]
    off = time.time()
    emulation.bus_off()
    state = client.wait_fault("bus-off", off, within=1.0)
    assert state["mode"] == "fault"
    aborted(client, "a", "can0")
    assert client.result("a")["switches"] == 0
    before, back = boards.switches().tolist(), time.time()
    emulation.restart()
    ready_by_itself(client, boards, back)
    assert boards.switches().tolist() != before, "by the goal after it"


@pytest.mark.buses("emulated")
def test_error_passive_is_told_and_the_arm_goes_on(
    emulation: emulated.Interface, client: Observer, motions: Motions
) -> None:
    emulation.tell(0x04, 0x20, tx_errors=130, rx_errors=7)

    def passive() -> bool:
        buses = [it["buses"][0] for it in client.heard["diagnostics"]]
        return any((bus["state"], bus["tx_errors"], bus["rx_errors"]) == ("passive", 130, 7) for bus in buses)

    eventually(passive)
    client.move(RIGHT)
    assert client.wait_now("ready")["faults"] == []


@pytest.mark.buses("emulated")
def test_a_queue_that_stays_full_is_told_and_what_is_in_it_switches_nothing(
    emulation: emulated.Interface, client: Observer, boards: Simulation, motions: Motions
) -> None:
    running(client)
    full = time.time()
    emulation.hold()  # ten frames later sending fails with ENOBUFS
    client.wait_fault("bus-busy", full, within=1.0)
    aborted(client, "a", "can0")
    assert client.wait_now("fault")["goal"] is None
    back = time.time()
    emulation.release()
    ready_by_itself(client, boards, back)


@pytest.mark.buses("emulated")
def test_a_goal_on_a_bus_that_takes_frames_and_lets_none_leave_switches_nothing(
    emulation: emulated.Interface, client: Observer, boards: Simulation, motions: Motions
) -> None:
    client.move(MIDDLE, goal="before")
    emulation.hold()
    full = time.time()
    assert client.goal(RIGHT, id="a")["accepted"]
    client.wait_fault("bus-busy", full, within=1.0)
    aborted(client, "a", "can0")
    assert client.result("a")["switches"] == 0
    back = time.time()
    emulation.release()
    ready_by_itself(client, boards, back)


def test_frames_of_others_at_the_full_rate_of_the_bus_do_not_stop_the_arm(
    client: Observer, boards: Simulation, listener: can.BusABC, motions: Motions
) -> None:
    """7,400 frames a second are a full bus of 1 Mbit/s; nobody's, of low priority, so that ours still leave."""
    ending = threading.Event()

    def flood() -> None:
        while not ending.wait(0.01):
            for _ in range(74):
                listener.send(cia301.frame(0x7E0, bytes(8)))

    flooding = threading.Thread(target=flood, daemon=True)
    flooding.start()
    try:
        for k in range(4):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
        eventually(lambda: any(it["buses"][0]["load"] > 0.3 for it in client.heard["diagnostics"]))
    finally:
        ending.set()
        flooding.join()
    assert client.wait_now("ready")["faults"] == []
