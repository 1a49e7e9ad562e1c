"""The PDOs of a simulated board: RPDOs applied at once or on SYNC, and TPDOs on change (CiA 301, 7.2.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.canopen.wire import cia301
from drivers.simulation.emergencies import Emergencies
from drivers.simulation.objects import Objects
from drivers.simulation.outputs import Outputs

_RPDOS, _TPDOS = range(0x1400, 0x1600), range(0x1800, 0x1A00)
_TOO_SHORT, _TOO_LONG, _SYNC_LENGTH = 0x8210, 0x8220, 0x8240
_SYNC_TOLERANCE = 1.5  # periods without a SYNC until it is an error, as in CANopenNode
_LAST_SYNCHRONOUS = 240  # transmission type


@dataclass(frozen=True)
class _Pdo:
    index: int
    cob_id: int
    synchronous: bool
    entries: list[tuple[int, int, int]]  # index, sub-index, bits

    @property
    def size(self) -> int:
        return sum(bits for *_, bits in self.entries) // 8


class Pdos:
    """All PDOs of a board that is operational.

    Args:
        objects: object dictionary with their parameters and mappings.
        outputs: takes the data of RPDOs.
        emergencies: takes errors of frames with a wrong length.
        send: takes COB-ID and data of a TPDO.

    Attributes:
        sync_due: latest time of the next SYNC [s]; infinity if none is expected.
    """

    def __init__(
        self, objects: Objects, outputs: Outputs, emergencies: Emergencies, send: Callable[[int, bytes], None]
    ) -> None:
        self.sync_due = math.inf
        self._objects, self._outputs, self._emergencies, self._send = objects, outputs, emergencies, send
        self._latched: dict[int, bytes] = {}  # data that the next SYNC applies, by index of the RPDO
        self._received = [index for index in _RPDOS if objects.has(index)]
        self._sent = [index for index in _TPDOS if objects.has(index)]
        self.configure()

    def configure(self) -> None:
        """Reads parameters and mappings from the object dictionary."""
        self._rpdos = self._pdos(self._received)
        self._tpdos = self._pdos(self._sent)

    def forget(self) -> None:
        """Drops latched data, and expects no SYNC."""
        self._latched.clear()
        self.sync_due = math.inf

    def receive(self, cob_id: int, data: bytes) -> bool:
        """Takes the frame of an RPDO; returns whether outputs may have changed."""
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
                self._latched[pdo.index] = data
            else:
                self._outputs.take(pdo.entries, data)
                changed = True
        return changed

    def sync(self, data: bytes, now: float) -> bool:
        """Applies a SYNC; returns whether outputs may have changed."""
        period = self._objects.number(0x1006) / 1e6
        self.sync_due = now + _SYNC_TOLERANCE * period if period else math.inf
        if len(data) != (self._objects.number(0x1019) != 0):  # with a counter, a SYNC has one byte
            self._emergencies.report(_SYNC_LENGTH)
            return False
        self._emergencies.recover(_SYNC_LENGTH)
        for pdo in self._rpdos:
            if pdo.index in self._latched:
                self._outputs.take(pdo.entries, self._latched[pdo.index])
        changed = bool(self._latched)
        self._latched.clear()
        return changed

    def publish(self, changed: Mapping[int, int] | None = None) -> None:
        """Sends TPDOs.

        Args:
            changed: changed bits of 6000h by sub-index; sends the TPDOs that carry them. None: sends all TPDOs.
        """
        if not self._objects.number(0x6005):
            return
        for pdo in self._tpdos:
            if changed is None or self._wakes(pdo, changed):
                values = (
                    self._objects.number(index, sub).to_bytes(bits // 8, "little") for index, sub, bits in pdo.entries
                )
                self._send(pdo.cob_id, b"".join(values))

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
                pdos.append(_Pdo(index, cob_id & 0x7FF, synchronous, self._objects.mapping(index)))
        return pdos
