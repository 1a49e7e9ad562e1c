"""Set-points: followed exactly if the contract allows it, begun when nothing stands in the way, ended at their time."""

from __future__ import annotations

from hyperbit.controller.program import Setpoint, Snapshot, unpack
from tests.simulation.judge.account import EPSILON, Account, Stream
from tests.simulation.judge.programs import Programs
from tests.simulation.judge.verdict import require
from tests.simulation.judge.waits import PROMPT, TICK


class Streams:
    """Judges the streams of one executor.

    Args:
        programs: ended by a followed set-point.
    """

    def __init__(self, account: Account, programs: Programs) -> None:
        self._a, self._programs = account, programs
        self.begin()

    def begin(self) -> None:
        self._held_at = self._a.now

    def receive(self, message: Setpoint) -> bool:
        """Takes a set-point, which is not answered; returns whether it is followed."""
        a = self._a
        if not self._fits(message):
            return False
        self._programs.end("replaced", "replaced", "replaced by a setpoint")
        a.stream = Stream(message, message.until)
        a.stream_number = message.stream
        a.greatest = max(a.greatest, message.stream)
        self._held_at = a.now
        return True

    def _fits(self, message: Setpoint) -> bool:
        """Returns whether the contract has the executor follow a set-point."""
        a = self._a
        if a.shown is None or a.quitting or a.mode not in ("ready", "executing"):
            return False
        if message.epoch != a.shown.epoch or a.now > message.until:
            return False
        if message.stream <= a.program_number or message.stream < a.stream_number:
            return False
        every = (message.start, *message.stages)
        if any(len(states) != a.arm.size or unpack(states) >> a.arm.count for states in every):
            return False
        pairs = zip(every, message.stages, strict=False)
        differ = [unpack(before) ^ unpack(after) for before, after in pairs]
        return not any(d & a.locked or d.bit_count() > a.arm.most for d in differ)

    def shown(self, snapshot: Snapshot) -> None:
        """Takes what a snapshot tells of the stream: outside of a clear world it decides."""
        a = self._a
        if snapshot.stream < 0 and (not a.clear or (a.stream is not None and a.now > a.stream.until)):
            a.stream = None

    def tick(self) -> None:
        """Finds streams that end late or are not followed."""
        a, stream = self._a, self._a.stream
        if stream is None or not a.clear:
            self._held_at = a.now
            return
        late = a.now - stream.until
        require(late <= 3 * TICK + EPSILON, f"stream {stream.message.stream} goes on {late:g} s after its end")
        stages = stream.message.stages
        commit = a.commit
        begun = commit is not None and commit.at >= self._held_at
        if not stages or begun or a.committing or a.homing or a.locked or stream.message.strict or late > 0:
            self._held_at = a.now
            return
        if self._kept(stream):
            self._held_at = a.now
        waited = a.now - self._held_at
        require(waited <= PROMPT, f"stream {stream.message.stream}: nothing keeps its stage from beginning")

    def _kept(self, stream: Stream) -> bool:
        """Returns whether something keeps the next stage of a stream from beginning, or there is none."""
        a, ground = self._a, self._a.ground
        stages = stream.message.stages
        if unpack(stream.message.start) != ground.states or unpack(stages[-1]) == ground.states:
            return True
        if not ground.surely_at_rest(a.now, 2 * TICK) or a.now < a.adopted_until + 2 * TICK:
            return True
        return any(a.now < ground.due(k) + a.arm.rest + 2 * TICK for k in range(a.arm.count))
