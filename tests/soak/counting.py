"""Switches as a stranger on the bus counts them: RPDOs decoded by the arm's file alone, switched by SYNC."""

import numpy as np

SYNC, RPDO1 = 0x080, 0x200


class SwitchCounter:
    """Counts every change of an output; boards begin with their outputs off.

    Attributes:
        counts: switches of each actuator, shape (A,).
        syncs: SYNC frames.

    Args:
        places: node id and output bit of each actuator, in the order of the state vectors.
    """

    def __init__(self, places: list[tuple[int, int]]) -> None:
        self.counts, self.syncs = np.zeros(len(places), dtype=np.int64), 0
        self._actuators = {(RPDO1 + node, bit): a for a, (node, bit) in enumerate(places)}
        self._outputs = {rpdo: 0 for rpdo, _ in self._actuators}
        self._latched: dict[int, int] = {}

    def take(self, cob_id: int, data: bytes) -> None:
        """Takes a frame."""
        if cob_id in self._outputs:
            self._latched[cob_id] = int.from_bytes(data, "little")
        elif cob_id == SYNC:
            self.syncs += 1
            for rpdo, value in self._latched.items():
                changed, self._outputs[rpdo] = value ^ self._outputs[rpdo], value
                for bit in range(changed.bit_length()):
                    if changed >> bit & 1:
                        self.counts[self._actuators[rpdo, bit]] += 1
            self._latched.clear()

    def off(self) -> None:
        """Notes that all boards were without supply: their outputs are off, and no command switched them."""
        self._outputs = dict.fromkeys(self._outputs, 0)
        self._latched.clear()
