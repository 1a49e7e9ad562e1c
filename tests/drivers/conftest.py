from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator

import can
import numpy as np
import pytest

from drivers.boards import Boards
from drivers.faults import BusBusy, Fault
from drivers.simulation.simulation import Simulation
from drivers.wiring import BusSettings, Channel, Timing, Wiring
from tests.daemon.waiting import SLOWNESS

_unique = itertools.count()


def wait(condition: Callable[[], object], patience: float = 20.0) -> None:
    deadline = time.monotonic() + patience * SLOWNESS
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.001)


class Rig:
    """Driver and simulated firmware on virtual buses, with a listener on each.

    The driver's time is what the test says; the boards' is real. The time-out for heartbeats is so long that real time
    alone loses nobody.
    """

    def __init__(self, channels: list[Channel], timing: Timing, **options: object) -> None:
        number = next(_unique)
        names = sorted({channel.bus for channel in channels})
        self.wiring = Wiring(
            buses=tuple(BusSettings(name, "virtual", f"{name}-{number}") for name in names),
            channels=tuple(channels),
            **options,
        )
        self.timing = timing
        # The listeners come first, so that no answer reaches them before its question.
        self.taps = {s.name: can.Bus(interface="virtual", channel=s.channel) for s in self.wiring.buses}
        self.simulation = Simulation(self.wiring, timing)
        self.faults: list[Fault] = []
        self.now = 0.0
        self._open: list[Boards] = []
        self.boards = self.driver()

    def driver(self) -> Boards:
        boards = Boards(self.wiring, self.timing)
        boards.subscribe(self.faults.append)
        self._open.append(boards)
        return boards

    def boot(self) -> None:
        """The boards have long booted when the driver comes."""
        self.simulation.start()
        self.boards.connect()
        self.frames()

    def up(self) -> Rig:
        self.boot()
        assert self.boards.start() == []
        self.boards.hold()
        self.frames()
        return self

    def frames(self, bus: str = "can0") -> list[tuple[int, str]]:
        """COB-ID and data of what was on the bus since the last call, without the boards' heartbeats."""
        seen = []
        while (message := self.taps[bus].recv(0)) is not None:
            if not 0x701 <= message.arbitration_id < 0x77F:
                seen.append((message.arbitration_id, bytes(message.data).hex(" ")))
        return seen

    def say(self, cob_id: int, data: bytes = b"", bus: str = "can0", **options: object) -> None:
        self.taps[bus].send(can.Message(arbitration_id=cob_id, data=data, **{"is_extended_id": False, **options}))

    def pass_time(self, seconds: float, step: float = 0.01) -> None:
        """The driver's control loop goes on for a while of its own time."""
        for _ in range(round(seconds / step)):
            self.now += step
            self.boards.tick(self.now)

    def commit(self, *states: int) -> None:
        """Commits as the control loop does: again and again while frames are on their way, on a slow machine."""

        def done() -> bool:
            try:
                self.boards.commit(np.array(states, dtype=np.uint8), self.now)
            except BusBusy as error:
                if "left yet" in str(error) or "on its way" in str(error):
                    return False
                raise
            return True

        wait(done)

    def arrive(self, *states: int) -> None:
        """Waits until the end-stops say so."""
        wait(lambda: self.boards.measured().tolist() == list(states))

    def codes(self) -> list[str]:
        return [fault.code for fault in self.faults]

    def choke(self, bus: str, after: int) -> Callable[[], None]:
        """Lets the bus take so many more frames and no more, until what is returned is called."""
        raw = self.boards._buses[bus]._bus
        send, left = raw.send, [after]

        def full(message: can.Message, timeout: float | None = None) -> None:
            if left[0] == 0:
                raise can.CanOperationError("No buffer space available", 105)
            left[0] -= 1
            send(message, timeout)

        raw.send = full
        return lambda: setattr(raw, "send", send)

    def close(self) -> None:
        for boards in self._open:
            boards.close()
        self.simulation.stop()
        for tap in self.taps.values():
            tap.shutdown()


@pytest.fixture
def make_rig() -> Iterator[Callable[..., Rig]]:
    rigs: list[Rig] = []

    def make(channels: list[Channel] | None = None, *, timing: Timing | None = None, **options: object) -> Rig:
        rigs.append(Rig(channels or one_board(), timing or patient(), **options))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()


@pytest.fixture(name="wait")
def _wait() -> Callable[..., None]:
    return wait


def patient(**changes: float) -> Timing:
    return Timing(**{"heartbeat": 0.02, "heartbeat_timeout": 60.0, "boot_timeout": 20.0, **changes})


@pytest.fixture(name="patient")
def _patient() -> Callable[..., Timing]:
    return patient


def one_board() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)]


@pytest.fixture
def two_boards() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("9.left", "can0", 9, 3, 2)]
