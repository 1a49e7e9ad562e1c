"""SDO client of one board: one transfer at a time, driven by frames and time (CiA 301, 7.2.4)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.link import Link, Outgoing

SDO_TIMEOUT, TRIES = 0.5, 3  # [s] for one answer, and attempts
_SLOW_FACTOR, _LONGEST_TIMEOUT = (
    2.5,
    3.0,
)  # timeout of a slow board: factor on its longest answer time, and its limit [s]
_LATE = 4.0  # [s] for which an answer to an earlier request may still come
_MOST_SEGMENTS = 8  # of one answer; a number of four bytes needs one
_WINDOW, _MOST_TWICE = 20, 15  # transfers in a window; double answers above which there are two boards
_TIMED_OUT, _TOO_LONG = 0x0504_0000, 0x0504_0005  # abort codes


@dataclass(frozen=True, slots=True)
class Transfer:
    index: int
    sub: int
    data: bytes | None = None  # 1..4 bytes to write; None: read
    timeout: float = SDO_TIMEOUT  # of one attempt [s]; longer for a board that answers slowly
    tries: int = TRIES
    fresh: bool = False  # a late answer to an earlier read must not count
    # write in two steps, by a segment (CiA 301, 7.2.4.3.3 and 7.2.4.3.4). A board that restarts after the first step
    # refuses the second one
    staged: bool = False

    @property
    def place(self) -> tuple[int, int]:
        return self.index, self.sub


class SdoOutcome(NamedTuple):
    """The result of a transfer: exactly one of its fields is set."""

    data: bytes | None = None  # the bytes read; empty after a write
    abort: int | None = None  # SDO abort code of the board
    silence: str | None = None  # why there is no answer


class SdoClient:
    """Reads and writes objects of one board.

    Answers are matched with requests by index and sub-index; late answers to other objects are dropped. A repeated
    request may be answered twice. Such a late answer must not count for a later write of the same object, or for a
    later read of the written value.
    """

    def __init__(self, node: int, link: Link) -> None:
        self.outcome: SdoOutcome | None = None  # result of the last transfer; None while it runs
        self._request_id = cia301.SDO_REQUEST + node
        self._link = link
        self._transfer: Transfer | None = None
        self._tries = 0
        self._multiplexer = b""  # index and sub-index as in the frames
        self._outgoing: Outgoing | None = None
        self._segments: bytes | None = None  # received so far; None outside a segmented answer
        self._expected = 0  # segments received
        self._asked = 0  # requests of this transfer
        self._asked_at = 0.0  # time of the first request
        self._slowest = 0.0  # longest answer time [s]
        self._owed: dict[bytes, tuple[int, float]] = {}  # by object: late answers to expect, until [s]
        self._skip = self._skipped = 0  # late answers to ignore, and answers that were ignored
        # whether three of four transfers were answered twice though asked once: two boards have the node id
        self.twice = False
        self._answered = self._doubled = 0  # transfers with one request; those with two answers
        self._last = b""  # object of the last such transfer, until its second answer

    def begin(self, transfer: Transfer, now: float) -> None:
        """Starts a transfer; a running one is cancelled."""
        self.cancel()
        self._transfer, self._tries = transfer, transfer.tries
        self._multiplexer = struct.pack("<HB", transfer.index, transfer.sub)
        self._asked = self._skipped = 0
        owed, until = self._owed.get(self._multiplexer, (0, 0.0))
        self._skip = owed if now < until and (transfer.data is not None or transfer.fresh) else 0
        self._request(now)

    def cancel(self) -> None:
        """Cancels the transfer, without an outcome."""
        if self._outgoing is not None:
            self._outgoing.cancelled = True
        self._transfer = self._outgoing = self._segments = self.outcome = None

    def receive_answer(self, data: bytes, now: float) -> None:
        """Takes a frame of 8 bytes from the board's SDO server."""
        transfer, outgoing = self._transfer, self._outgoing
        if transfer is None or outgoing is None or outgoing.first_at is None:
            self._receive_late(data[1:4])
            return
        kind = data[0] & 0xE0
        if self._segments is not None and kind == (0x00 if transfer.data is None else 0x20):
            self._link.answered(outgoing, now)
            if transfer.data is None:
                self._receive_segment(data, now)
            else:
                self._end(SdoOutcome(data=b""))
            return
        if data[1:4] != self._multiplexer:
            self._receive_late(data[1:4])
            return
        if self._skip > 0:  # perhaps late; the answer to a new request is right
            self._skip -= 1
            self._skipped += 1  # if it was not late, the late one may still come: it stays owed, for no longer
            self._link.answered(outgoing, now)
            self._request(now)
            return
        self._link.answered(outgoing, now)
        self._slowest = max(self._slowest, now - (self._asked_at if self._asked > 1 else outgoing.first_at))
        if repeated := self._asked - 1 - self._skipped:
            self._owe(repeated, now)
        elif self._asked == 1:
            self._count_answer()
        if kind == 0x80:
            self._end(SdoOutcome(abort=int.from_bytes(data[4:], "little")))
        elif self._segments is not None:
            return
        elif transfer.data is not None and kind == 0x60 and transfer.staged:
            self._segments = b""
            self._send(bytes((2 * (7 - len(transfer.data)) | 1,)) + transfer.data.ljust(7, b"\0"), now)
        elif transfer.data is not None and kind == 0x60:
            self._end(SdoOutcome(data=b""))
        elif transfer.data is None and kind == 0x40:
            if data[0] & 0x02:  # expedited; without a size, four bytes
                self._end(SdoOutcome(data=data[4 : 8 - (data[0] >> 2 & 3 if data[0] & 1 else 0)]))
            else:
                self._segments, self._expected = b"", 0
                self._send(bytes((0x60, 0, 0, 0, 0, 0, 0, 0)), now)

    def tick(self, now: float) -> None:
        """Repeats the request, or ends the transfer, after the timeout."""
        transfer, outgoing = self._transfer, self._outgoing
        if transfer is None or outgoing is None or outgoing.first_at is None:
            return
        if now - outgoing.first_at < max(transfer.timeout, min(_SLOW_FACTOR * self._slowest, _LONGEST_TIMEOUT)):
            return
        outgoing.cancelled = True
        if self._segments is not None:
            self._abort(_TIMED_OUT, now)
        self._tries -= 1
        if self._tries > 0:
            self._request(now)
        else:
            self._owe(self._asked - self._skipped, now)
            self._end(SdoOutcome(silence=f"no SDO answer within {transfer.timeout:g} s, asked {transfer.tries} times"))

    def _request(self, now: float) -> None:
        assert self._transfer is not None
        data, self._segments = self._transfer.data, None
        if not self._asked:
            self._asked_at = now
        self._asked += 1
        if data is None:
            self._send(b"\x40" + self._multiplexer + bytes(4), now)
        elif self._transfer.staged:
            self._send(b"\x21" + self._multiplexer + len(data).to_bytes(4, "little"), now)
        else:
            kind = 0x23 | (4 - len(data)) << 2
            self._send(bytes((kind,)) + self._multiplexer + data.ljust(4, b"\0"), now)

    def _owe(self, answers: int, now: float) -> None:
        """Records answers that may still come."""
        owed, until = self._owed.get(self._multiplexer, (0, 0.0))
        self._owed[self._multiplexer] = owed * (now < until) + answers, now + _LATE

    def _receive_late(self, multiplexer: bytes) -> None:
        """Takes a late answer to another object, or to an earlier request."""
        if (owed := self._owed.get(multiplexer)) is not None:
            if owed[0] > 1:
                self._owed[multiplexer] = owed[0] - 1, owed[1]
            else:
                del self._owed[multiplexer]
        elif multiplexer == self._last:
            self._last = b""
            self._doubled += 1

    def _count_answer(self) -> None:
        """Counts a transfer with one request; decides `twice` after _WINDOW transfers."""
        if self._answered == _WINDOW:
            self.twice = self._doubled >= _MOST_TWICE
            self._answered = self._doubled = 0
        self._answered += 1
        self._last = self._multiplexer

    def _receive_segment(self, data: bytes, now: float) -> None:
        assert self._segments is not None
        if data[0] >> 4 & 1 != self._expected & 1:
            return  # a repeated segment
        self._segments += data[1 : 8 - (data[0] >> 1 & 7)]
        self._expected += 1
        if data[0] & 1:
            self._end(SdoOutcome(data=self._segments))
        elif self._expected >= _MOST_SEGMENTS:
            self._abort(_TOO_LONG, now)
            self._end(SdoOutcome(silence=f"its answer is longer than {_MOST_SEGMENTS} segments"))
        else:
            self._send(bytes((0x60 | (self._expected & 1) << 4, 0, 0, 0, 0, 0, 0, 0)), now)

    def _abort(self, code: int, now: float) -> None:
        frame = Frame(self._request_id, b"\x80" + self._multiplexer + code.to_bytes(4, "little"))
        self._link.queue(Outgoing(frame), now)

    def _send(self, data: bytes, now: float) -> None:
        self._outgoing = Outgoing(Frame(self._request_id, data))
        self._link.queue(self._outgoing, now)

    def _end(self, outcome: SdoOutcome) -> None:
        self.cancel()
        self.outcome = outcome
