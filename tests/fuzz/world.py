"""An executor's core, its CAN bus and simulated boards in one thread on one simulated clock, so that runs reproduce.

Core, CANopen master, decoding of python-can's messages, and simulated firmware are the real code. The bus delivers each
frame at once. Time advances only on request.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any, Literal

import can

from controller.executor.core import PERIOD, Executor
from controller.executor.events import Action, Client, ClientGone, FromClient, Log, Send, Tick, ToClient
from controller.executor.switch_journal import MemoryJournal
from controller.program import VERSION, Alive, Cancel, Down, Goodbye, Halt, Hello, Lock, Program, Reset, Stage, pack
from drivers.canopen.wire import cia301
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wiring import BusSettings, Channel, Timing, Wiring
from drivers.simulation.buses import SimulatedBuses
from tests.executor.rig import LABELS, SIZE, small_arm
from tests.fuzz.judge import Judge, Moved, Wedged

NODES = (5, 9)
TRAVEL = 0.02
TIMING = Timing(heartbeat=0.02, heartbeat_timeout=0.07, boot_timeout=0.1, travel_time=TRAVEL)
BUS = BusSettings("can0", "virtual", "fuzz")
CHANNELS = tuple(
    Channel(label, "can0", NODES[k // 3], k % 3, None if k == 5 else k % 3) for k, label in enumerate(LABELS)
)
RPDOS = tuple(cia301.RPDO1 + node for node in NODES)
TPDOS = tuple(cia301.TPDO1 + node for node in NODES)
# What boards obey, whoever sends it.
COMMANDS = {cia301.NMT, cia301.SYNC, *RPDOS, *(cia301.SDO_REQUEST + node for node in NODES)}
PLANNER, OPERATOR = Client(1, 4001), Client(2, 4002)


class Wire(CanBus):
    """The executor's bus; it checks sent frames and queues received ones."""

    def __init__(self, world: World) -> None:
        super().__init__(BUS, lambda: world.now)
        self._world = world
        self.waiting: deque[can.Message] = deque()
        self.open()

    def _open(self) -> Any:
        return self

    def recv(self, timeout: float) -> can.Message | None:
        return self.waiting.popleft() if self.waiting else None

    def send(self, frame: Frame) -> str | None:
        """Answers are there before this returns."""
        world = self._world
        world.judge.judge(frame, world.core, lambda node: world.boards.board(f"can0/{node}").pins)
        self.waiting.append(message(frame, own=True))
        self._world.ambush(frame)
        return None

    def shutdown(self) -> None:
        pass


class World:
    """One arm of two boards with executor, bus, planner, and an intruder on the bus.

    Attributes:
        now: [s].
        judge: checks all frames of the executor.
        lines: of the log.
        last: line of the log.
        dirty: whether the intruder may have commanded the boards.
    """

    def __init__(self) -> None:
        self.now = 1000.0
        self.arm = replace(small_arm(), wiring=Wiring((BUS,), CHANNELS), timing=TIMING)
        self.boards = SimulatedBuses(self.arm.wiring, TIMING, lambda _, frame: self.wire.waiting.append(message(frame)))
        self.wire = Wire(self)
        self.core = Executor(self.arm, MemoryJournal(SIZE), instance=1)
        self.master = self.core._master
        self.judge = Judge(self.arm.wiring)
        self.boots = self.lines = 0
        self.last, self.dirty = "", True
        self._answers: list[tuple[int, int, bytes]] = []
        self._booting = False
        self._turned_away = [PLANNER, OPERATOR]
        self.connect()
        self.recover()

    # --- events

    def do(self, event: Any) -> None:
        """Passes an event to the core, and carries out the resulting actions."""
        self.judge.begin()
        events = deque([event])
        while events:
            actions = self.core.step(events.popleft(), self.now)
            for action in sorted(actions, key=lambda it: isinstance(it, Send)):
                self._act(action)
            events += self.wire.poll()
        self.boots += self.master.booting and not self._booting
        self._booting = self.master.booting
        self.judge.end(self.core.modes.mode == "executing")

    def _act(self, action: Action) -> None:
        match action:
            case Send():
                self.wire.send(action.frame)
            case ToClient(message=Goodbye()):
                self._turned_away.append(action.client)
            case ToClient(client=client) if client == PLANNER:
                self.judge.heard(action.message)
            case Log():
                self.lines += 1
                self.last = action.text
                assert "internal error" not in action.text, action.text

    # --- time

    def go(self, ticks: int = 1) -> None:
        """Advances the time of all parts by a number of periods."""
        for _ in range(ticks):
            self.now += PERIOD
            self.boards.step(self.now)
            self.send(Alive())
            self.do(Tick())

    # --- the planner

    def connect(self) -> None:
        """Connects the clients, at the start or after a refusal."""
        for client in self._turned_away:
            self.do(ClientGone(client))
        gone, self._turned_away = self._turned_away, []
        for client in gone:
            role: Literal["planner", "operator"] = "planner" if client == PLANNER else "operator"
            self.send(Hello(VERSION, role, self.arm.name), client)

    def send(self, message: Down, client: Client = PLANNER) -> None:
        """Sends a message of a client; programs of an operator must be refused."""
        if client == PLANNER:
            self.judge.proposed(message)
        self.do(FromClient(client, message))
        if self._turned_away:
            self.connect()

    def program(self, *stages: int, step: float = 0.04) -> None:
        """Sends a program that begins at the arm's present states."""
        number = self.core._requests.greatest + 1
        packed = tuple(Stage(pack(states, SIZE), k * step, k, k * step) for k, states in enumerate(stages))
        start, epoch = pack(self.master.outputs, SIZE), self.core.modes.epoch
        self.send(Program(number, epoch, start, 0.0, packed, True, False, "goal"))

    # --- frames

    def attack(self, it: can.Message) -> None:
        """Sends a frame of the intruder to the executor and to the boards."""
        standard = not (it.is_extended_id or it.is_remote_frame or it.is_error_frame or it.is_fd)
        self.dirty |= standard and it.arbitration_id in COMMANDS
        means_nothing = not (standard or it.is_error_frame)
        wrong_length = standard and it.arbitration_id in TPDOS and it.dlc != 1
        self._hear_all()
        before = self.master._network.measured, self.master.known
        self.wire.waiting.append(it)
        self._hear_all()
        if means_nothing and (self.master._network.measured, self.master.known) != before:
            raise AssertionError(f"taken for the state of a board: {it}")
        if wrong_length and self.master._network.measured != before[0]:
            raise AssertionError(f"taken for inputs: {it}")
        if standard:
            self.boards.receive("can0", Frame(it.arbitration_id, bytes(it.data)), self.now)
            self._hear_all()

    def _hear_all(self) -> None:
        for event in self.wire.poll():
            self.do(event)

    def arm_ambush(self, mode: int, index: int, data: bytes) -> None:
        """Queues an SDO answer of the intruder to the master's next request for an object; 0: any object."""
        self._answers.append((mode, index, data))

    def ambush(self, frame: Frame) -> None:
        """Delivers a frame of the master to the boards; the intruder may answer before them or instead of them."""
        if self._answers and frame.id & 0x780 == cia301.SDO_REQUEST and frame.data[0] != 0x80:
            asked = int.from_bytes(frame.data[1:3], "little")
            place = next((k for k, (_, index, _) in enumerate(self._answers) if index in (0, asked)), None)
            if place is not None:
                mode, _, data = self._answers.pop(place)
                if mode & 1:  # an answer to the question
                    data = data[:1] + frame.data[1:4] + data[4:]
                self.dirty = True  # the master may believe that the outputs are others
                answer = Frame(frame.id - cia301.SDO_REQUEST + cia301.SDO_ANSWER, data)
                self.wire.waiting.append(message(answer))
                if mode & 2:
                    return
        self.boards.receive("can0", frame, self.now)

    def supply(self, node: int, on: bool) -> None:
        """Switches a board's supply off or on."""
        self.dirty = True
        (self.boards.power_on if on else self.boards.power_cut)(f"can0/{node}")

    # --- what must hold

    def check_outputs(self) -> None:
        """Compares the boards' outputs with the master's commands, unless the intruder commanded them.

        Raises:
            Moved: they differ.
        """
        drives = sum(drive << k for k, drive in enumerate(self.boards.drives()))
        if not self.dirty and drives != self.master.outputs:
            raise Moved(f"the outputs are {drives:06b}, switched to {self.master.outputs:06b}")

    def recover(self) -> None:
        """Removes all faults, resets, and checks that the arm becomes ready.

        Raises:
            Wedged: the arm does not become ready.
        """
        self._answers.clear()
        if self.dirty:
            for node in NODES:
                self.supply(node, on=False)
                self.supply(node, on=True)
            self.go(8)
        self.wire.waiting.append(can.Message(arbitration_id=0x100, is_error_frame=True))  # the controller is restarted
        self.send(Cancel(1, None, "over"))
        self.go(12)
        for k in range(SIZE):
            self.send(Lock(2, k, -1))
        if self.core.modes.mode != "ready":
            self.send(Halt(3))
            self.send(Reset(4))
            self.go(15)
        self.judge.clear()
        if self.core.modes.mode != "ready":
            raise Wedged(f"{self.core.modes.mode} after a reset: {self.core.modes.reason}")
        self.dirty = False
        self.check_outputs()


def message(frame: Frame, own: bool = False) -> can.Message:
    """Returns a frame as a message of python-can."""
    return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False, is_rx=not own)
