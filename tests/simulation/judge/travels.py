"""Travels in results: from the SYNC that switched an actuator to the frame that reports its end-stop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hyperbit.controller.program import MOST_TRAVELS, Travel
from tests.simulation.judge.account import EPSILON, Account, Run
from tests.simulation.judge.arm import bits_of
from tests.simulation.judge.verdict import require

SDO_REQUEST, READS_INPUTS = 0x600, b"\x40\x00\x60"
FRAME = 0.02  # [s], longest time from an end-stop to the end of its frame, behind others on a slow bus


class Arrival:
    """An actuator that has reached an end with an end-stop.

    Attributes:
        asked: whether the executor may not have measured it, because its board was asked, or a frame was on its way.
        due: whether the result of its program must tell it.
    """

    def __init__(self, actuator: int, state: int, seconds: float, at: float) -> None:
        self.actuator, self.state, self.seconds, self.at = actuator, state, seconds, at
        self.asked = False
        self.due = False


class Travels:
    """Measures the travels of each program, and judges those in its result."""

    def __init__(self, account: Account, arm: Any) -> None:
        self._a = account
        self._boards = [
            [f"{line.bus}/{line.node}" for name in ("contracted", "") if (line := c.line(f"input_{name}".rstrip("_")))]
            for c in arm.wiring.channels
        ]
        self._read_at: dict[str, float] = {}  # time of the last request for the inputs of each board
        self._switched: dict[int, tuple[float, int, bool]] = {}  # by actuator: time, state, whether its end was read
        self._arrived: list[Arrival] = []  # in no result yet

    def begin(self) -> None:
        self._switched.clear()
        self._arrived.clear()

    def hands_out(self, bus: str, frame_id: int, data: bytes) -> None:
        """A frame is handed to a bus: a board that is asked for its inputs may answer before its TPDO comes."""
        if frame_id & 0x780 == SDO_REQUEST and data[:3] == READS_INPUTS:
            self._read_at[f"{bus}/{frame_id & 0x7F}"] = self._a.now

    def _asked(self, arrival: Arrival) -> bool:
        """Returns whether the board of an end-stop was asked for its inputs just before an arrival."""
        asked = (self._read_at.get(board, -1e12) for board in self._boards[arrival.actuator])
        return any(arrival.at - FRAME < at < arrival.at + FRAME for at in asked) or arrival.asked

    def switched(self, mask: int) -> None:
        a, reading = self._a, self._a.ground.readings[-1]
        lately = a.ground.readings_since(a.now - FRAME)  # what the executor may have heard
        for one in self._arrived:  # the frame of its end-stop may come after this SYNC
            one.asked |= bool(mask >> one.actuator & 1) and a.now - one.at < FRAME
        for k in bits_of(mask):
            self._switched.pop(k, None)
            state = a.ground.states >> k & 1
            ends = a.arm.extended_ends if state else a.arm.contracted_ends
            reads = reading.extended if state else reading.contracted
            if ends >> k & 1 and not reads >> k & 1:
                unheard = any((r.extended if state else r.contracted) >> k & 1 for r in lately)
                self._switched[k] = a.now, state, unheard

    def reads(self, extended: int, contracted: int) -> None:
        now = self._a.now
        for k, (at, state, unheard) in list(self._switched.items()):
            if (extended if state else contracted) >> k & 1:
                del self._switched[k]
                arrival = Arrival(k, state, now - at, now)
                arrival.asked = unheard or self._asked(arrival)
                self._arrived.append(arrival)

    def ended(self, run: Run, ended_at: float, told: tuple[Travel, ...], text: str) -> None:
        """Judges the travels of a result: those that have arrived while its program was running."""
        first = max(run.accepted_at, self._a.clear_since) + FRAME
        for one in self._arrived:
            one.due = first < one.at < ended_at - FRAME and not self._asked(one) and len(told) < MOST_TRAVELS
        left = list[Arrival]()
        for way in {(each.actuator, each.state) for each in (*told, *self._arrived)}:
            travels = [travel for travel in told if (travel.actuator, travel.state) == way]
            arrived = [one for one in self._arrived if (one.actuator, one.state) == way]
            others = _others(travels, arrived)
            require(others is not None, f"{text} tells {travels}; arrived are {[vars(one) for one in arrived]}")
            left += others or ()
        self._arrived = [one for one in left if one.at >= self._a.now - FRAME]


def _others(told: Sequence[Travel], arrived: Sequence[Arrival]) -> list[Arrival] | None:
    """Returns the arrivals that no told travel means, all of one actuator and in order; None if no order fits."""
    count = len(arrived)
    able = [[False] * (count + 1) for _ in range(len(told))]  # whether told[i:] may mean some of arrived[j:]
    able.append([not any(one.due for one in arrived[j:]) for j in range(count + 1)])
    for i in reversed(range(len(told))):
        for j in reversed(range(count)):
            means = _fits(told[i], arrived[j]) and able[i + 1][j + 1]
            able[i][j] = means or (not arrived[j].due and able[i][j + 1])
    if not able[0][0]:
        return None
    others, i = list[Arrival](), 0
    for j, one in enumerate(arrived):
        if i < len(told) and _fits(told[i], one) and able[i + 1][j + 1]:
            i += 1
        else:
            others.append(one)
    return others


def _fits(travel: Travel, arrival: Arrival) -> bool:
    return 0.0 <= travel.seconds - arrival.seconds + EPSILON <= FRAME
