"""The CANopen master of an arm: frames and time in, frames, actuator states and faults out."""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen.cia301 import Frame
from drivers.canopen.events import Event
from drivers.canopen.faults import Fault
from drivers.canopen.status import Status
from drivers.canopen.wiring import Timing, Wiring


class Master:
    """All boards of an arm, on all its buses.

    It is pure: no I/O, no clock, no threads, and nothing waits. Actuator k is bit k of an integer of states or of a
    mask. `now` is CLOCK_MONOTONIC [s], or any clock that never goes back. No event raises.

    Args:
        wiring: buses, boards and actuators.
        timing: times of boards and actuators.
        send: hands out a frame for a bus, by its name; must not call the master. It never fails: the fate of the frame
            comes back as `echoed` or `send_failed`, and `send_failed` before the next `tick`.

    Attributes:
        board_of: index of each actuator's board.
        sensed: mask of the actuators that have an end-stop.
    """

    board_of: tuple[int, ...]
    sensed: int

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None: ...

    # --- events

    def take(self, event: Event, now: float) -> None:
        """Takes an event of a bus: calls one of the five methods below."""

    def receive(self, bus: str, frame: Frame, now: float) -> None:
        """Takes a standard data frame of another node."""

    def ignore(self, bus: str, bits: int, now: float) -> None:
        """Counts a frame of another kind, of so many bits on the wire."""

    def echoed(self, bus: str, frame: Frame, now: float) -> None:
        """Takes a frame that left this computer; one that is not ours counts as received."""

    def send_failed(self, bus: str, frame: Frame, why: str, now: float) -> None:
        """Notes that a frame of ours was not sent."""

    def bus_changed(self, bus: str, state: str | None, why: str, errors: tuple[int, int] | None, now: float) -> None:
        """Notes the state of a bus (None: as before) and its error counters (None: as before)."""

    def tick(self, now: float) -> None:
        """Does what time brings; to be called every 10 ms.

        It sends the master's heartbeat, which no other method does: boards of a hanging executor become safe. It ends
        time-outs of SDO transfers, boot and commit, and finds lost boards and stuck buses. A late call alone ends no
        time-out.
        """

    def halted(self, now: float) -> Fault | None:
        """Returns a fault if `tick` was not called for so long that the boards were without their master.

        The states of all boards are unknown from then on, until `boot`. To be called before anything is acted on;
        `tick` and `commit` look as well, and then the fault is in `take_faults`.
        """
        raise NotImplementedError

    # --- commands

    def boot(self, now: float) -> None:
        """Boots all boards of all buses in parallel; switches no output.

        Boards that are operational and configured as they should be are left alone. It may be called at any time, also
        while booting: then it starts again. Faults so far are forgotten.
        """

    def commit(self, states: int, now: float) -> None:
        """Switches all actuators to `states`, on each bus at one instant: RPDOs, and when all have left, SYNC.

        Nothing is sent if nothing changes. The end shows in `committing`, `commit_failed` and `take_switched`.

        Raises:
            Busy: a commit is under way, or a bus or a board is not up.
        """

    def question(self, board: int, now: float) -> None:
        """Asks a board for its inputs by SDO; see `questioning`."""

    def probe_silent(self, now: float) -> None:
        """Asks boards that were lost whether they are back; see `back`. To be called once a second or so."""

    # --- queries

    @property
    def booting(self) -> bool:
        """Whether a boot is under way."""
        raise NotImplementedError

    @property
    def boot_faults(self) -> list[Fault]:
        """Faults of the last boot: one for each board or bus that is not up; empty if all are up."""
        raise NotImplementedError

    @property
    def ready(self) -> bool:
        """Whether all boards are up with known states, and all buses are armed."""
        raise NotImplementedError

    @property
    def back(self) -> bool:
        """Whether `boot` may succeed: frames leave on all buses, and all boards are heard."""
        raise NotImplementedError

    @property
    def committing(self) -> bool:
        """Whether a commit is under way."""
        raise NotImplementedError

    @property
    def commit_failed(self) -> str | None:
        """Why the last commit failed, as a sentence; None if it did not. Nothing of it is sent later."""
        raise NotImplementedError

    @property
    def outputs(self) -> int:
        """States as of the last SYNC that is known to have left, or as read back by `boot`."""
        raise NotImplementedError

    @property
    def outputs_known(self) -> bool:
        """Whether `outputs` are known: all boards are up, and no SYNC is on its way."""
        raise NotImplementedError

    @property
    def measured(self) -> int:
        """States from the end-stops, else from the outputs; 0 where unknown."""
        raise NotImplementedError

    @property
    def known(self) -> int:
        """Mask of the actuators whose board is up."""
        raise NotImplementedError

    def questioning(self, board: int) -> bool:
        """Whether a question to a board is neither answered nor timed out."""
        raise NotImplementedError

    def take_faults(self) -> list[Fault]:
        """Returns the faults since the last call; each code and source once until the next `boot`."""
        raise NotImplementedError

    def take_switched(self) -> list[tuple[int, float]]:
        """Returns the switches since the last call: a mask of actuators, and when their SYNC was known to have left."""
        raise NotImplementedError

    def warnings(self) -> tuple[Fault, ...]:
        """Returns a warning for each bus that is error-passive."""
        raise NotImplementedError

    def status(self) -> Status:
        """Returns state and counters for diagnostics."""
        raise NotImplementedError
