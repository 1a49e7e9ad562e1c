"""Simulated boards on CAN buses of python-can, with a thread for each bus."""

from __future__ import annotations

import contextlib
import errno
import threading
import time
from collections.abc import Callable, Iterator, Mapping

import can
import numpy as np
from numpy.typing import NDArray

from hyperbit.drivers.canopen.wire.cia301 import BUS_OFF, REMOTE, RESTARTED, Frame
from hyperbit.drivers.canopen.wiring import BusWiring, Timing, Wiring
from hyperbit.drivers.simulation import fault_commands
from hyperbit.drivers.simulation.buses import SimulatedBuses
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.variants import Variant

_GONE = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)  # the interface is down or deleted
_LONGEST_WAIT = 0.01  # [s] for a frame, so that a fault takes effect soon


class Port:
    """The boards' connection to one bus; reopened after a loss of the interface."""

    def __init__(self, wiring: BusWiring) -> None:
        self._wiring = wiring
        self._failed = False
        self.bus: can.BusABC | None = self._open()

    def receive_frame(self, timeout: float) -> can.Message | None:
        try:
            if self._failed:  # the kernel reports the loss of an interface only once, also to a send
                self.close()
                self._failed, self.bus = False, None
            if self.bus is None:
                self.bus = self._open()
            return self.bus.recv(timeout)
        except (can.CanError, OSError):  # the interface is down or deleted: the boards continue without frames
            self.close()
            self.bus = None
            time.sleep(timeout)
            return None

    def send_frame(self, frame: Frame) -> None:
        """Sends a frame if possible. A board does not learn of a failure."""
        if (bus := self.bus) is not None:
            try:
                bus.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))
            except (can.CanError, OSError) as error:
                self._failed |= getattr(error, "error_code", None) in _GONE

    def send_error(self, state: str) -> None:
        """Sends SocketCAN's error frame for a state of the controller, "bus-off" or "active"."""
        if (bus := self.bus) is not None:
            number = BUS_OFF if state == "bus-off" else RESTARTED
            with contextlib.suppress(can.CanError, OSError):
                bus.send(can.Message(arbitration_id=number, data=bytes(8), is_error_frame=True, is_extended_id=False))

    def close(self) -> None:
        if self.bus is not None:
            self.bus.shutdown()

    def _open(self) -> can.BusABC:
        s = self._wiring
        return can.Bus(interface=s.interface, channel=s.channel, bitrate=s.bitrate, ignore_config=True)


class Simulation:
    """All boards of a wiring. They share only frames with the driver.

    Args:
        timing: gives the travel time; simulated actuators take half of it.
        clock: returns the time [s].
        variants: of boards by name; the other boards are standard boards.

    Raises:
        KeyError: there is no board of this name.
        can.CanError, OSError: a bus cannot be opened.
    """

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        clock: Callable[[], float] = time.monotonic,
        variants: Mapping[str, Variant] | None = None,
    ) -> None:
        self.boards = SimulatedBuses(
            wiring,
            timing,
            lambda bus, frame: self.ports[bus].send_frame(frame),
            variants,
            lambda bus, state: self.ports[bus].send_error(state),
        )
        self.ports = {settings.name: Port(settings) for settings in wiring.buses}
        self.lock = threading.RLock()  # for each access to the boards
        self._clock = clock
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        with self.lock:
            self.boards.step(self._clock())
        for name, port in self.ports.items():
            thread = threading.Thread(target=self._run, args=(name, port), name=f"simulate {name}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def stop(self) -> None:
        self._ending.set()
        for thread in self._threads:
            thread.join()
        for port in self.ports.values():
            port.close()

    def positions(self) -> NDArray[np.float64]:
        """Returns the positions of the actuators, 0 contracted to 1 extended, shape (A,)."""
        with self.lock:
            return np.array(self.boards.positions())

    def switches(self) -> NDArray[np.int64]:
        """Returns the number of switches of each valve, shape (A,)."""
        with self.lock:
            return np.array(self.boards.switches(), dtype=np.int64)

    def fault(self, *words: str | float) -> None:
        """Causes or ends a fault; the words are those of `fault_commands`, e.g. "stick", "5.left", 1."""
        with self.lock:
            self.boards.step(self._clock())
            fault_commands.perform(self.boards, *words)

    def play_fault(self, text: str) -> str:
        """Plays a fault such as "silence can0/5"; returns the answer. Raises ValueError with the choices."""
        with self.lock:
            self.boards.step(self._clock())
            return fault_commands.play(self.boards, text)

    @contextlib.contextmanager
    def board(self, name: str) -> Iterator[SimulatedBoard]:
        """Yields a board, e.g. "can0/5", while no frame reaches any board."""
        with self.lock:
            self.boards.step(self._clock())
            yield self.boards.board(name)

    def _run(self, bus: str, port: Port) -> None:
        while not self._ending.is_set():
            wait = self.boards.next_due() - self._clock()
            message = port.receive_frame(min(max(wait, 0.0), _LONGEST_WAIT))
            with self.lock:
                while message is not None:
                    if not (message.is_error_frame or message.is_extended_id or message.is_fd):
                        remote = message.is_remote_frame
                        frame = Frame(message.arbitration_id | REMOTE * remote, b"" if remote else bytes(message.data))
                        self.boards.receive(bus, frame, self._clock())
                    message = port.receive_frame(0.0)
                self.boards.step(self._clock())
