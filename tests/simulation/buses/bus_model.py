"""A model of one CAN bus and of the controller through which the executor reaches it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from random import Random
from typing import NamedTuple

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, SYNC, Frame, split, wire_bits
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from tests.simulation.agenda import Agenda

MAILBOXES = 3  # of the controller; frames in them compete by identifier
CAPACITY = 13  # frames in mailboxes and queue; Linux gives a CAN interface a queue of 10 frames
LATE = 0.03  # [s]
SDO_ANSWER, HEARTBEAT, MASTER_HEARTBEAT = 0x580, 0x700, 0x77F
RPDOS = range(0x200, 0x580, 0x100)  # function codes of RPDO 1 to 4
TPDOS = range(0x180, 0x580, 0x100)  # function codes of TPDO 1 to 4


def nothing() -> None:
    """Is what happens at an RPDO or SYNC of which nobody waits."""


def pass_on(frame: Frame) -> str:
    """Lets each frame pass."""
    return ""


class OnItsWay(NamedTuple):
    """A frame of the executor; `belongs_to` is its commit, for the world."""

    frame: Frame
    belongs_to: object


class BusModel:
    """One bus: one frame at a time, the lowest identifier first, each as long as its bits.

    Frames of the executor wait in a queue in front of the controller's mailboxes. Its faults are attributes that the
    world changes, and the methods below. Boards hear each other, but no SDO answers and heartbeats of each other.

    Attributes:
        bitrate: [bit/s].
        capacity: frames of the executor that may wait; a further one is refused.
        mailboxes: number of the first of them that compete by identifier.
        room: number of the next frames of the executor that are taken; None: as many as fit.
        stuck: whether the executor's frames stay in the controller, which hears all others.
        echoes: whether the executor gets its own frames back.
        log: frames that have left; None: they are not logged.
        acknowledged: whether any node acknowledges the executor's frames; if not, they stay in the controller,
            and it hears none.
        loss: share of the frames that their receiver loses after they have left.
        duplication: share of the frames that their receiver gets twice.
        answer_delay: longest delay of the boards' SDO answers [s].
        mute: whether the boards' SDO answers are lost.
        intercept: called with each frame to or from a board; returns "" to let it pass, "lose", "twice" or "late".
        late: delay of a frame of a board that comes "late" [s].
        tpdos_to_lose: number of the next TPDOs that are lost.
        echo_lost_at: time of the last lost echo [s].
        echo_owed: whether the echoes of a command and of the heartbeats after it were lost.

    Args:
        to_boards: takes a frame of the executor when it has left, what it belongs to, and whether the boards lose it.
    """

    def __init__(
        self,
        name: str,
        bitrate: int,
        agenda: Agenda,
        random: Random,
        to_boards: Callable[[str, OnItsWay, bool], None],
        to_executor: Callable[[Event], None],
    ) -> None:
        self.name, self.state = name, "active"
        self.capacity, self.mailboxes, self.acknowledged = CAPACITY, MAILBOXES, True
        self.loss = self.duplication = self.answer_delay = 0.0
        self.mute, self.tpdos_to_lose = False, 0
        self.bitrate, self.room, self.stuck, self.echoes = bitrate, None, False, True
        self.log: list[Frame] | None = None
        self._agenda, self._random = agenda, random
        self._to_boards, self._to_executor = to_boards, to_executor
        self._at_rpdo: list[Callable[[], None]] = []
        self._at_sync: Callable[[], None] = nothing
        self.intercept: Callable[[Frame], str] = pass_on
        self.late = LATE
        self._queue: deque[OnItsWay] = deque()  # of the executor; the first ones are in the mailboxes
        self._others: deque[Frame] = deque()
        self._echoes_to_lose, self._loses_syncs = 0, False  # of the next RPDOs or SYNCs
        self.echo_lost_at = -1e12
        self.echo_owed = self._command_unknown = False
        self._on_wire: OnItsWay | Frame | None = None  # of the executor, or of a board

    @property
    def healthy(self) -> bool:
        """Whether frames of the executor are sent at once."""
        return self._sends and self.capacity == CAPACITY

    @property
    def _connected(self) -> bool:
        return self.state in ("active", "passive") and self.acknowledged

    @property
    def _sends(self) -> bool:
        return self._connected and not self.stuck

    def send_frame(self, frame: Frame, belongs_to: object = None) -> str | None:
        """Takes a frame of the executor; returns why it cannot be sent, or None."""
        if self.state == "down":
            return "Network is down"
        if len(self._queue) >= self.capacity or self.room == 0:
            return "No buffer space available"
        if self.room is not None:
            self.room -= 1
        if split(frame.id)[0] in RPDOS:
            due, self._at_rpdo = self._at_rpdo, []
            for happen in due:
                happen()
        if frame.id == SYNC:
            happen, self._at_sync = self._at_sync, nothing
            happen()
        self._queue.append(OnItsWay(frame, belongs_to))
        self.begin()
        return None

    def from_other(self, frame: Frame) -> None:
        """Takes a frame of another program or an unknown board."""
        self._others.append(frame)
        self.begin()

    def from_board(self, frame: Frame) -> None:
        function = split(frame.id)[0]
        if self.mute and function == SDO_ANSWER:
            return
        if self.tpdos_to_lose and function in TPDOS:
            self.tpdos_to_lose -= 1
        elif self.answer_delay and function == SDO_ANSWER:
            self._agenda.after(self._random.uniform(0.0, self.answer_delay), partial(self.from_other, frame))
        else:
            self.from_other(frame)

    def at_next_rpdo(self, happen: Callable[[], None]) -> None:
        """Calls a function once, when the executor hands out an RPDO."""
        self._at_rpdo.append(happen)

    def await_no_rpdo(self) -> None:
        self._at_rpdo.clear()

    def at_next_sync(self, happen: Callable[[], None]) -> None:
        """Calls a function once, when the executor hands out a SYNC."""
        self._at_sync = happen

    def drop(self) -> None:
        """Loses the frames that wait in queue and controller."""
        self._queue.clear()

    def restart(self) -> None:
        """Restarts the controller, without its waiting frames."""
        self.drop()
        self._change("active", "")

    def go_down(self) -> None:
        """Takes the interface down: waiting frames are lost."""
        self.drop()
        self._change("down", "the interface is down")

    def go_off(self) -> None:
        """Makes the controller bus-off: waiting frames stay in it."""
        self._change("bus-off", "")

    def warn(self) -> None:
        """Makes the controller error-passive, which does not stop frames."""
        if self.state == "active":
            self._change("passive", "")

    def lose_echo(self, count: int = 1, sync: bool = False) -> None:
        """Loses the echoes of the next RPDOs, or of the next SYNCs."""
        self._echoes_to_lose, self._loses_syncs = count, sync

    def hear_answers(self) -> None:
        self.mute = False

    def restore(self) -> None:
        self.capacity, self.acknowledged = CAPACITY, True
        self.loss = self.duplication = self.answer_delay = 0.0
        self.room, self.stuck, self.echoes = None, False, True
        self.mute, self.tpdos_to_lose, self.intercept = False, 0, pass_on
        if self.state != "active":
            self._change("active", "")
        self.begin()

    def _change(self, state: str, why: str) -> None:
        self.state = state
        self._to_executor(BusChanged(self.name, state, why, (128, 0) if state == "passive" else None))
        self.begin()

    def begin(self) -> None:
        """Puts the next frame on the wire if the wire is free."""
        if self._on_wire is not None:
            return
        ours = list(self._queue)[: self.mailboxes] if self._sends else []
        first = min(ours, key=lambda waiting: _rank(waiting.frame), default=None)
        other = min(self._others, key=_rank, default=None)
        if first is not None and (other is None or _rank(first.frame) <= _rank(other)):
            self._queue.remove(first)
            self._on_wire, size = first, len(first.frame.data)
        elif other is not None:
            self._others.remove(other)
            self._on_wire, size = other, len(other.data)
        else:
            return
        self._agenda.after(wire_bits(size) / self.bitrate, self._finish)

    def _finish(self) -> None:
        on_wire, self._on_wire = self._on_wire, None
        lost = self._random.random() < self.loss
        twice = not lost and self._random.random() < self.duplication
        if isinstance(on_wire, OnItsWay) and not self._sends:
            if self.state != "down":
                self._queue.appendleft(on_wire)  # it stays in the controller
        elif isinstance(on_wire, OnItsWay):
            self._note(on_wire.frame)
            lost_one = on_wire.frame.id == SYNC if self._loses_syncs else split(on_wire.frame.id)[0] in RPDOS
            loses = lost_one and self._echoes_to_lose > 0
            self._echoes_to_lose -= loses
            heard = self.echoes and not loses
            self._note_echo(on_wire.frame, heard)
            if heard:
                self._to_executor(FrameEchoed(self.name, on_wire.frame, self._agenda.now))
            what = self.intercept(on_wire.frame)
            for _ in range(1 + (twice or what == "twice")):
                self._to_boards(self.name, on_wire, lost or what == "lose")
        elif on_wire is not None:
            self._note(on_wire)
            what = self.intercept(on_wire)
            if what == "late":
                self._agenda.after(self.late, partial(self._deliver, on_wire, lost))
            for _ in range({"lose": 0, "late": 0, "twice": 2}.get(what, 1 + twice)):
                self._deliver(on_wire, lost)
        self.begin()

    def _deliver(self, frame: Frame, lost: bool) -> None:
        """Delivers a frame of a board or of another program."""
        if self._connected and not lost:
            self._to_executor(FrameReceived(self.name, frame, self._agenda.now))
        if frame.id == MASTER_HEARTBEAT or split(frame.id)[0] not in (SDO_ANSWER, HEARTBEAT):
            self._to_boards(self.name, OnItsWay(frame, None), lost)

    def _note_echo(self, frame: Frame, heard: bool) -> None:
        """Notes a lost echo, of which the executor learns by the echo of a later heartbeat."""
        if not heard:
            self.echo_lost_at = self._agenda.now
        if frame.id == MASTER_HEARTBEAT:
            self.echo_owed = self._command_unknown and not heard
            self._command_unknown &= not heard
        elif frame.id < SDO_ANSWER:
            self._command_unknown |= not heard

    def _note(self, frame: Frame) -> None:
        if self.log is not None:
            self.log.append(frame)


def _rank(frame: Frame) -> tuple[int, bool]:
    """Returns the place of a frame in arbitration: by identifier, data frames before remote frames."""
    return frame.id & ~REMOTE, bool(frame.id & REMOTE)
