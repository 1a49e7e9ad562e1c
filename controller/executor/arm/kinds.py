"""Sets of actuators as masks, actuator k is bit k; and their kinds, which map states to outputs and end-stops."""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import NamedTuple

from hyperbit.drivers.canopen.wiring import Interlock, Timing, Wiring


def indices(mask: int) -> Iterator[int]:
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


def mask_of(actuators: Iterable[int]) -> int:
    return sum(1 << k for k in actuators)


def merged(mask: int, chosen: int, other: int) -> int:
    """Returns the bits of `chosen` where the mask is set, those of `other` elsewhere."""
    return (chosen & mask) | (other & ~mask)


def first(mask: int, count: int) -> int:
    """Returns the mask of the first `count` actuators of a mask, or of all if there are fewer."""
    return mask_of(islice(indices(mask), max(count, 0)))


class Ends(NamedTuple):
    """Masks of the actuators whose switch at this end reads 1."""

    extended: int
    contracted: int


class Kinds:
    """The kinds of A actuators. Only `believe` changes them.

    An actuator has one output and a spring, or a pair of outputs. At most one output of a pair is on. While both are
    off, the actuator stays in its state. Outputs and inputs are masks of lines, in the order of `Wiring`.

    Attributes:
        everything, paired, pulsed: masks of all actuators, of those with two outputs, and with pulsed outputs.
        ends_extended, ends_contracted, sensed: masks of those with an end-stop at this end, and at any end.
        trusted: mask of actuators without verification (`verify: false` in the arm's file).
        pulse: length of the pulse by actuator index [s].
        believed: whether the end-stops are; otherwise each actuator counts as one without.
        travel: longest times to the contracted and to the extended end, shape (A, 2) [s].
        margin: settle margin, added to these times before an actuator counts as late, shape (A,) [s].
    """

    def __init__(self, wiring: Wiring, timing: Timing) -> None:
        channels, self._size = wiring.channels, len(wiring.channels)
        self.everything = (1 << self._size) - 1
        self._pairs, self._ended, self._outputs_of = wiring.paired, wiring.ended, wiring.outputs_of
        self.paired = mask_of(self._pairs)
        self.pulse = {k: channel.pulse for k, channel in enumerate(channels) if channel.pulse is not None}
        self.pulsed = mask_of(self.pulse)
        unverified = {(node.bus, node.node) for node in wiring.nodes if not node.verify}
        self._unverified = mask_of(k for k, c in enumerate(channels) if (c.bus, c.node) in unverified)
        self._inputs = mask_of(k for k, channel in enumerate(channels) if channel.input is not None)
        self.believe(True)
        times = timing.travel_time
        self.travel = tuple((times, times) if channel.travel is None else channel.travel for channel in channels)
        self.margin = tuple(
            timing.settle_margin if channel.settle_margin is None else channel.settle_margin for channel in channels
        )
        self.interlocks = wiring.interlocks  # in the order of their input lines
        self._first_interlock = self._size + len(self._ended)

    def believe(self, ends: bool) -> None:
        """Believes the end-stops, or takes each actuator for one without."""
        self.ends_extended, self.ends_contracted = (self._inputs, mask_of(self._ended)) if ends else (0, 0)
        self.sensed = self.ends_extended | self.ends_contracted
        self.trusted = self._unverified & ~self.sensed
        self.believed = ends

    def outputs(self, states: int, on: int) -> int:
        """Returns the outputs for states. Of the paired actuators, only those of the mask `on` have an output on."""
        if not self.paired:
            return states
        return (states & (on | ~self.paired)) | self._off_lines(on & ~states)

    def lines(self, actuators: int) -> int:
        """Returns both output lines of each of some paired actuators."""
        return actuators | self._off_lines(actuators)

    def on(self, outputs: int) -> tuple[int, int]:
        """Returns two masks of paired actuators: extending output on, contracting output on."""
        if not self.paired:
            return 0, 0
        contracting = outputs >> self._size
        return outputs & self.paired, mask_of(k for i, k in enumerate(self._pairs) if contracting >> i & 1)

    def actuators(self, lines: int) -> int:
        return lines & self.everything | self.on(lines)[1]

    def states(self, outputs: int, before: int) -> int:
        """Returns the states for outputs; `before` where both outputs of a pair are off, or both on."""
        if not self.paired:
            return outputs & self.everything
        extending, contracting = self.on(outputs)
        return merged((extending ^ contracting) | ~self.paired, outputs, before) & self.everything

    def ends(self, inputs: int) -> Ends:
        if not self._ended:
            return Ends(inputs & self.ends_extended, 0)
        contracted = inputs >> self._size
        closed = mask_of(k for i, k in enumerate(self._ended) if contracted >> i & 1)
        return Ends(inputs & self.ends_extended, closed & self.ends_contracted)

    def definite(self, ends: Ends) -> int:
        """Returns the mask of the actuators whose end-stops show a state.

        Two end-stops show no state while the actuator is between its ends, or if both read 1.
        """
        both = self.ends_extended & self.ends_contracted
        return self.sensed & ~(both & ~(ends.extended ^ ends.contracted))

    def measured(self, ends: Ends, commanded: int) -> int:
        """Returns the states that the end-stops show; `commanded` where they show none."""
        reads = merged(self.ends_extended, ends.extended, ~ends.contracted)
        return merged(self.definite(ends), reads, commanded)

    def open(self, inputs: int, known: int) -> list[Interlock]:
        return [self.interlocks[i] for i in indices((known & ~inputs) >> self._first_interlock)]

    def _off_lines(self, actuators: int) -> int:
        return sum(self._outputs_of[k] for k in indices(actuators & self.paired)) & ~self.everything
