"""What moves: no stage touches an obstacle, nothing moves after a stop, and streams of set-points end."""

from __future__ import annotations

from hyperbit.controller.program import Acknowledge, Setpoint, unpack
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Ran, Request
from tests.simulation.judge.interface.modules import Cube
from tests.simulation.judge.verdict import require

BEGUN_WITHIN = 0.1  # [s]: a stage that has begun before obstacles were confirmed has switched after it
DISTURBED_WITHIN = 0.6  # [s], the same if frames of a stage are held up by a bus
PAUSE = 0.25  # [s] without a set-point, after which a stream has ended
HEARD_WITHIN = 0.05  # [s] from the arrival of a set-point to its stages, and from a stop to the end of a stream


class Motion:
    """Judges switches and followed set-points."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account
        self.begin()

    def begin(self) -> None:
        self.stop: Request | None = None
        self._cancels: list[Request] = []  # and stops that were answered, the newest last
        self._last: dict[str, float] = {}  # time of the last set-point of each sender [s]
        self._chains: dict[str, int] = {}  # number of the first one of its stream

    def executor_begins(self) -> None:
        """A new process of the executor knows of no stop."""
        self.stop = None

    def switches(self, mask: int, ran: Ran | None) -> None:
        """Judges actuators that a SYNC has switched for a program, or for set-points."""
        a, stop, snapshot = self._a, self.stop, self._a.snapshot
        if stop is not None and a.clear():
            require(a.now <= stop.answered_at, f"{mask:b} switched after the answer to {stop}, without a later reset")
        if ran is not None and ran.request is not None and ran.process == a.process:
            for cancel in self._cancels:
                named = cancel.number > ran.request.number and cancel.goal in (None, ran.goal)
                late = named and cancel.answered_at < a.now
                require(not late, f"{mask:b} switched for {ran.goal} after the answer to {cancel}")
        begun = BEGUN_WITHIN if a.clear() else DISTURBED_WITHIN
        if not a.sure() or snapshot is None or unpack(snapshot.homing) or a.now < a.cubes_at + begun:
            return
        pending = [set(r.cubes) for r in a.waiting("obstacles")]
        cubes = set(a.cubes).intersection(*pending)
        if not cubes:
            return
        locked = unpack(snapshot.locked)
        held = unpack(snapshot.measured) & locked
        after = a.driven() & ~locked | held
        before = (a.driven() ^ mask) & ~locked | held
        if ran is not None and ran.jog and not {before, ran.states} <= a.modules.tips.keys():
            return  # a jog from no configuration is not checked, and its answer says so
        touched = [cube for cube in cubes if Cube.touched(cube, before, after)]
        require(not touched, f"a stage from {before:b} to {after:b} touches {touched}")

    def bars(self, request: Request) -> None:
        self._cancels = [*self._cancels[-9:], request]
        if request.key == "stop":
            later = [r for r in self._a.requests if r.key == "reset" and r.number > request.number]
            self.stop = None if later else request

    def resets(self) -> None:
        self.stop = None

    def setpoint(self, sender: str, number: int) -> None:
        """Records a set-point that counts, and the number of the first one that it has displaced."""
        now = self._a.now
        if now - self._last.get(sender, -1e12) > PAUSE - 0.01:
            self._chains[sender] = number
        self._last[sender] = now

    def follows(self, message: Setpoint) -> None:
        """Judges stages for a followed set-point: somebody streams, and no request has ended this stream."""
        a = self._a
        if not message.stages or not a.process or not a.clear():
            return
        alive = [s for s, last in self._last.items() if a.now - last <= PAUSE + 2 * HEARD_WITHIN]
        require(alive, f"{message}, but nobody has sent a set-point for {PAUSE} s")
        begun = max(self._chains[sender] for sender in alive)
        for request in reversed(a.requests):
            ends = request.key == "stop" or (request.key == "cancel" and request.goal is None)
            if ends and request.accepted and request.answered_at < a.now - HEARD_WITHIN:
                require(begun > request.number, f"{message}, but {request} has ended this stream")
                break
        for ran in a.programs.values():
            replaces = ran.request is not None and ran.process == a.process and ran.at < a.now - 2 * HEARD_WITHIN
            if replaces and ran.request is not None:
                require(begun > ran.request.number, f"{message}, but {ran.goal} has ended this stream")

    def acknowledges(self, message: Acknowledge) -> None:
        """Judges that a result was published and recorded before it is acknowledged."""
        a = self._a
        for ran in a.programs.values():
            if ran.instance == a.instance and ran.ended is not None and ran.ended.result == message.result:
                asked = ran.request is not None or bool(ran.results)
                require(not asked or ran.results, f"the result of {ran.goal} was acknowledged, not published")
                lost = a.had("disk", ran.at)
                require(not asked or ran.recorded or lost, f"the result of {ran.goal} was acknowledged, not recorded")
