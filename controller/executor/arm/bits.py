"""Sets of actuators as masks: actuator k is bit k of an integer."""

from collections.abc import Iterator
from itertools import islice


def indices(mask: int) -> Iterator[int]:
    """Yields the indices of a mask's actuators in ascending order."""
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


def merged(mask: int, chosen: int, other: int) -> int:
    """Returns the bits of `chosen` where the mask is set, those of `other` elsewhere."""
    return (chosen & mask) | (other & ~mask)


def first(mask: int, count: int) -> int:
    """Returns the mask of the first `count` actuators of a mask, or of all if there are fewer."""
    return sum(1 << k for k in islice(indices(mask), max(count, 0)))
