"""The PDOs of a simulated board: RPDOs applied at once or on SYNC, and TPDOs on change (CiA 301, 7.2.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.simulation.emergencies import Emergencies
from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.outputs import SimulatedOutputs

_RPDOS, _TPDOS = range(0x1400, 0x1600), range(0x1800, 0x1A00)
_TOO_SHORT, _TOO_LONG, _SYNC_LENGTH = 0x8210, 0x8220, 0x8240
_SYNC_TOLERANCE = 1.5  # an error after this number of periods without SYNC, as in CANopenNode
_LAST_SYNCHRONOUS = 240  # transmission type


@dataclass(frozen=True)
class _Pdo:
    index: int
    cob_id: int
    synchronous: bool
    period: float  # event timer of a TPDO [s]; 0: none
    entries: list[tuple[int, int, int]]  # index, sub-index, bits

    @property
    def size(self) -> int:
        return sum(bits for *_, bits in self.entries) // 8


class Pdos:
    """All PDOs of an operational board; `pads`: whether TPDOs are filled up to 8 bytes."""

    def __init__(
        self,
        objects: Objects,
        outputs: SimulatedOutputs,
        emergencies: Emergencies,
        send: Callable[[int, bytes], None],
        pads: bool,
    ) -> None:
        self.sync_due = math.inf  # latest time of the next SYNC [s]; infinity if none is expected
        self.losing = 0  # number of the next TPDOs that do not reach the bus
        self._window_ends = math.inf  # time after which synchronous RPDOs come too late [s]
        self._sent_at: dict[int, float] = {}  # last time of each TPDO since the start, by its index [s]
        self._objects, self._outputs, self._emergencies, self._send = objects, outputs, emergencies, send
        self._pads = pads
        self._latched: dict[int, bytes] = {}  # data that the next SYNC applies, by index of the RPDO
        self._received = [index for index in _RPDOS if objects.has(index)]
        self._sent = [index for index in _TPDOS if objects.has(index)]
        self.configure()

    def configure(self) -> None:
        self._rpdos = self._pdos(self._received)
        self._tpdos = self._pdos(self._sent)
        self._timed = [pdo for pdo in self._tpdos if pdo.period]

    def forget(self) -> None:
        """Drops latched data, expects no SYNC, and sends no TPDO by its event timer."""
        self._latched.clear()
        self._sent_at.clear()
        self.sync_due = self._window_ends = math.inf

    @property
    def due(self) -> float:
        """Time when a SYNC is missing or an event timer ends [s]."""
        return min([self.sync_due, *map(self._event_due, self._timed)])

    def receive(self, cob_id: int, data: bytes, now: float) -> bool:
        """Takes the frame of an RPDO; returns whether outputs may have changed.

        A synchronous RPDO after the synchronous window, 1007h, of the last SYNC is dropped.
        """
        changed = False
        for pdo in self._rpdos:
            if pdo.cob_id != cob_id:
                continue
            if len(data) < pdo.size:
                self._emergencies.report(_TOO_SHORT)
                continue
            if len(data) > pdo.size:  # the mapped bytes are applied all the same
                self._emergencies.report(_TOO_LONG)
            else:
                self._emergencies.recover(_TOO_SHORT)
                self._emergencies.recover(_TOO_LONG)
            if pdo.synchronous:
                if now <= self._window_ends:
                    self._latched[pdo.index] = data
            else:
                self._outputs.receive_rpdo(pdo.entries, data)
                changed = True
        return changed

    def sync(self, data: bytes, now: float) -> bool:
        """Applies a SYNC; returns whether outputs may have changed."""
        period = self._objects.number(0x1006) / 1e6
        self.sync_due = now + _SYNC_TOLERANCE * period if period else math.inf
        window = self._objects.number(0x1007) / 1e6
        self._window_ends = now + window if window else math.inf
        if len(data) != (self._objects.number(0x1019) != 0):  # with a counter, a SYNC has one byte
            self._emergencies.report(_SYNC_LENGTH)
            return False
        self._emergencies.recover(_SYNC_LENGTH)
        for pdo in self._rpdos:
            if pdo.index in self._latched:
                self._outputs.receive_rpdo(pdo.entries, self._latched[pdo.index])
        changed = bool(self._latched)
        self._latched.clear()
        return changed

    def start(self, now: float) -> None:
        """Sends all TPDOs unless 6005h masks the inputs, and starts their event timers."""
        for pdo in self._tpdos:
            self._sent_at[pdo.index] = now
            if self._objects.number(0x6005):
                self._transmit(pdo, now)

    def publish(self, changed: Mapping[int, int], now: float) -> None:
        """Sends the TPDOs that carry changed bits of 6000h; `changed`: bits by sub-index."""
        if self._objects.number(0x6005):
            for pdo in self._tpdos:
                if self._wakes(pdo, changed):
                    self._transmit(pdo, now)

    def repeat(self, now: float) -> None:
        for pdo in self._timed:
            if now >= self._event_due(pdo):
                self._transmit(pdo, now)

    def _event_due(self, pdo: _Pdo) -> float:
        return self._sent_at.get(pdo.index, math.inf) + pdo.period

    def _transmit(self, pdo: _Pdo, now: float) -> None:
        self._sent_at[pdo.index] = now
        if self.losing:
            self.losing -= 1
            return
        values = (self._objects.number(index, sub).to_bytes(bits // 8, "little") for index, sub, bits in pdo.entries)
        self._send(pdo.cob_id, b"".join(values).ljust(8 if self._pads else 0, b"\xff"))

    def _wakes(self, pdo: _Pdo, changed: Mapping[int, int]) -> bool:
        """Returns whether a TPDO carries a changed input that 6006h does not mask."""
        masked = self._objects.has(0x6006)
        subs = [sub for index, sub, _ in pdo.entries if index == 0x6000]
        return any(changed[sub] & (self._objects.number(0x6006, sub) if masked else 0xFF) for sub in subs)

    def _pdos(self, indices: list[int]) -> list[_Pdo]:
        pdos = []
        for index in indices:
            cob_id = self._objects.number(index, 1)
            if not cob_id & cia301.INVALID:
                synchronous = self._objects.number(index, 2) <= _LAST_SYNCHRONOUS
                period = self._objects.number(index, 5) / 1000
                pdos.append(_Pdo(index, cob_id & 0x7FF, synchronous, period, self._objects.mapping(index)))
        return pdos
