"""A daemon's control loop, CAN driver and simulated boards in one thread on one clock: what happens can be had again.

The real parts are the loop, the driver and the firmware. Between them lies a wire that hands each frame over at once,
and time passes only when it is told to, also while the driver waits for its boards to start.
"""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable

import can
import numpy as np
from numpy.typing import NDArray

from controller.daemon.bringup import BringUp
from controller.daemon.events import Cancel, Payload, Planned, Reset, Stop
from controller.daemon.ledger import Ledger
from controller.daemon.loop import PERIOD, ControlLoop
from drivers import cia301
from drivers.boards import Boards
from drivers.canopen.cia301 import Frame
from drivers.simulation.buses import SimulatedBuses
from drivers.wiring import MASTER, BusSettings, Channel, Timing, Wiring
from tests.daemon.rig import ARM, FakeLedger, planned

NODES = (5, 9)
TRAVEL = 0.02
TIMING = Timing(heartbeat=0.02, heartbeat_timeout=0.07, boot_timeout=0.1, travel_time=TRAVEL)
CHANNELS = tuple(
    Channel(label, "can0", NODES[k // 3], k % 3, None if k == 5 else k % 3) for k, label in enumerate(ARM.actuators)
)
RPDOS = tuple(cia301.RPDO1 + node for node in NODES)
TPDOS = tuple(cia301.TPDO1 + node for node in NODES)
QUESTIONS = (b"\x00\x10", b"\x00\x60")  # objects that may be asked for at any time: device type and inputs
# What boards obey, whoever sends it.
COMMANDS = {cia301.NMT, cia301.SYNC, *RPDOS, *(cia301.SDO_REQUEST + node for node in NODES)}
_channels = itertools.count()


class Moved(AssertionError):
    """Something was switched, or sent, that no accepted goal asked for."""


class Wedged(AssertionError):
    """After all trouble was over, a reset did not bring the arm up."""


class Flood(AssertionError):
    """The journal grew with the frames."""


class Journal(logging.Handler):
    """Counts what would be written to the journal."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines = 0
        self.last = ""

    def emit(self, record: logging.LogRecord) -> None:
        self.lines += 1
        self.last = record.getMessage()
        if record.exc_info is not None and isinstance(record.exc_info[1], Moved):
            raise record.exc_info[1]
        if record.exc_info is not None:
            raise AssertionError(f"caught as a defect: {self.last}") from record.exc_info[1]


class Wire:
    """The bus as the driver sees it; each frame that it sends is judged, and answered before `send` returns."""

    def __init__(self, world: World) -> None:
        self._world = world

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self._world.judge(message)
        self._world.to_boards(message)
        self._world.ambush(message)

    def shutdown(self) -> None:
        pass


class News(threading.Condition):
    """The driver's word that a frame came; who waits for it lets time pass."""

    def __init__(self, world: World) -> None:
        super().__init__()
        self._world = world

    def wait_for(self, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
        end = self._world.now + (timeout or 0.0)
        while not predicate() and self._world.now < end:
            self._world.tick()
        return predicate()


class Silent:
    """No word to systemd."""

    watchdog = None

    def send(self, *states: str) -> None:
        pass


class LaterBringUp(BringUp):
    """Brings the boards up when the world says so, in the same thread."""

    due: Callable[[], None] | None = None

    def begin(self) -> None:
        if self.running:
            self._again = True
            return
        self.running, self._again, self.due = True, False, self._work


class World:
    """One arm of two modules, its daemon, its bus, and who sends what on it.

    Args:
        ledger: of the daemon's; one that only counts if absent.
    """

    def __init__(self, ledger: Ledger | None = None) -> None:
        self.now = 1000.0
        self.journal = Journal()
        wiring = Wiring((BusSettings("can0", "virtual", f"fuzz-{next(_channels)}"),), CHANNELS)
        self.simulation = SimulatedBuses(wiring, TIMING, lambda _, frame: self.from_boards(cia301.frame(*frame)))
        self.boards = Boards(wiring, TIMING)
        self.can = self.boards._buses["can0"]
        self.can._bus, self.can.state = Wire(self), "active"
        for sdo in self.boards._sdos:
            sdo._client.RESPONSE_TIMEOUT = 0.0  # all answers are there at once, or never
        self.boards._news = self.boards._startup._news = self.boards._commits._news = News(self)
        self.ledger = ledger or FakeLedger()
        self._arrival = 0
        self.loop = ControlLoop(
            ARM, self.boards, TRAVEL, self.publish, self, self.ledger, Silent(), lambda: self._arrival, lambda: self.now
        )  # fmt: skip
        self._bring_up = self.loop._bring_up = LaterBringUp(self.boards, self.loop.inbox.put)
        self._starting = False
        self._latched: dict[int, bytes] = {}
        self._answers: list[tuple[int, int, bytes]] = []
        self.syncs = self.starts = 0
        self.dirty = True
        self.loop.begin()
        self.recover()

    # --- what the loop shows

    def show(self, snapshot: object) -> None:
        pass

    def diagnose(self, diagnostics: object) -> None:
        pass

    def publish(self, key: str, payload: Payload) -> None:
        pass

    # --- time

    def tick(self) -> None:
        """Lets one period pass for all."""
        self.now += PERIOD
        self.simulation.step(self.now)
        self.loop.step()

    def go(self, ticks: int = 1) -> None:
        """Lets time pass, and brings the boards up when that is asked for."""
        for _ in range(ticks):
            self.tick()
            while (start := self._bring_up.due) is not None:
                self._bring_up.due, self._starting = None, True
                self.starts += 1
                start()
                self._starting = False
                self.tick()

    # --- frames

    def attack(self, message: can.Message) -> None:
        """Lets a stranger send a frame: to the driver and to the boards."""
        standard = not (message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd)
        self.dirty |= standard and message.arbitration_id in COMMANDS
        means_nothing = not (standard or message.is_error_frame)
        wrong_length = standard and message.arbitration_id in TPDOS and message.dlc != 1
        before = self._known()
        ready = {cia301.TPDO1 + node.board.node: node.ready for node in self.boards._nodes}
        self.can._receive(message)
        if (means_nothing or wrong_length) and self._known() != before:
            raise AssertionError(f"taken for the state of a board: {message}")
        if wrong_length and ready[message.arbitration_id]:
            name = f"can0/{message.arbitration_id - cia301.TPDO1}"
            assert ("wrong-length", name) in self.boards._faults._told, f"passed over: {message}"
        self.to_boards(message)

    def _known(self) -> tuple[bytes, list[object]]:
        """What the driver takes the boards' states for."""
        return self.boards._inputs.tobytes(), [(node.state, node.ready) for node in self.boards._nodes]

    def to_boards(self, message: can.Message) -> None:
        standard = not (message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd)
        if standard:
            self.simulation.receive("can0", Frame(message.arbitration_id, bytes(message.data)), self.now)

    def from_boards(self, message: can.Message) -> None:
        self.can._receive(message)

    def arm_ambush(self, mode: int, index: int, data: bytes) -> None:
        """Has an SDO answer of a stranger meet the driver's next question for an object, 0 any, while boards start."""
        self._answers.append((mode, index, data))

    def ambush(self, message: can.Message) -> None:
        if not self._answers or message.arbitration_id & 0x780 != cia301.SDO_REQUEST or message.data[0] == 0x80:
            return
        asked = int.from_bytes(message.data[1:3], "little")
        place = next((k for k, (_, index, _) in enumerate(self._answers) if index in (0, asked)), None)
        if place is None:
            return
        mode, _, data = self._answers.pop(place)
        if mode & 1:  # an answer to the question
            data = data[:1] + bytes(message.data[1:4]) + data[4:]
        self.dirty = True  # the driver may believe that the outputs are others
        responses = self.boards._sdos[NODES.index(message.arbitration_id & 0x7F)]._client.responses
        if mode & 2:  # in place of the true one
            while not responses.empty():
                responses.get()
        self.can._receive(cia301.frame(message.arbitration_id - cia301.SDO_REQUEST + cia301.SDO_ANSWER, data))

    # --- requests

    def goal(self, *configurations: tuple[int, int]) -> None:
        """Hands a goal over, with its plan."""
        self._arrival += 1
        plan = planned(*configurations, step=0.04)
        self.loop.inbox.hand_over(Planned(self._arrival, lambda _: None, f"goal {self._arrival}", plan))

    def request(self, kind: type[Cancel | Stop | Reset]) -> None:
        self._arrival += 1
        self.loop.inbox.hand_over(kind(self._arrival, lambda _: None))

    def supply(self, node: int, on: bool) -> None:
        """Takes a board's supply away, or gives it back."""
        self.dirty = True
        (self.simulation.power_on if on else self.simulation.power_cut)(f"can0/{node}")

    # --- what must hold

    def judge(self, message: can.Message) -> None:
        """Refuses every frame of the daemon that it may not send now.

        Raises:
            Moved: it may not.
        """
        cob_id, data = message.arbitration_id, bytes(message.data)
        execution = self.loop._runner.execution
        if cob_id == cia301.HEARTBEAT + MASTER:
            return
        if cob_id in RPDOS and execution is not None and not self._starting:
            self._latched[cob_id] = data
            return
        if cob_id == cia301.SYNC and execution is not None and not self._starting:
            self.syncs += 1
            asked = [stage.tolist() for way in execution.plan.transitions for stage in way.stages]
            if self._sent() not in asked:
                raise Moved(f"{self._sent()} was switched, the goal asks for {asked}")
            return
        if cob_id & 0x780 == cia301.SDO_REQUEST and data[0] == 0x40 and data[1:3] in QUESTIONS:
            return
        if self._starting and (cob_id == cia301.NMT or cob_id & 0x780 == cia301.SDO_REQUEST):
            if cob_id != cia301.NMT and data[:1] != b"\x80" and data[1:3] == b"\x00\x62" and data[0] & 0xE0 == 0x20:
                raise Moved("outputs were written by SDO")
            return
        raise Moved(f"{cob_id:03X}h {data.hex()} was sent in mode {self.loop.mode} without a goal that asks for it")

    def _sent(self) -> list[int]:
        """The (A,) states in the frames sent last, of boards not sent any what the driver took over from them."""
        wanted = self.boards.outputs()
        for cob_id, data in self._latched.items():
            mine = [k for k, c in enumerate(CHANNELS) if cia301.RPDO1 + c.node == cob_id]
            wanted[mine] = [data[0] >> CHANNELS[k].output & 1 for k in mine]
        return wanted.tolist()

    def drives(self) -> NDArray[np.uint8]:
        """(A,) what the boards' outputs drive."""
        return np.array(self.simulation.drives(), dtype=np.uint8)

    def check_outputs(self) -> None:
        """Compares the boards' outputs with what the daemon switched, if no stranger commanded them.

        Raises:
            Moved: they differ.
        """
        if not self.dirty and self.drives().tolist() != self.boards.outputs().tolist():
            raise Moved(f"the outputs are {self.drives().tolist()}, switched to {self.boards.outputs().tolist()}")

    def recover(self) -> None:
        """Ends the trouble, resets, and expects the arm to be ready.

        Raises:
            Wedged: it is not.
        """
        self._answers.clear()
        if self.dirty:
            for node in NODES:
                self.supply(node, on=False)
                self.supply(node, on=True)
            self.go(8)
        if self.can.state == "bus-off":
            self.can._receive(can.Message(arbitration_id=0x100, is_error_frame=True))
        self.request(Cancel)
        self.go(4)
        if self.loop.mode != "ready":
            self.request(Stop)
            self.request(Reset)
            self.go(3)
        self._latched.clear()
        if isinstance(self.ledger, FakeLedger):
            self.ledger.goals.clear()
        self.go(1)
        if self.loop.mode != "ready":
            raise Wedged(f"{self.loop.mode} after a reset: {self.loop.reason}")
        self.dirty = False
        self.check_outputs()
