"""Snapshots: each field is true within a stated delay, and they come as often as they must."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.controller.program import Snapshot, unpack
from tests.simulation.judge.account import EPSILON, Account
from tests.simulation.judge.arm import mask_of
from tests.simulation.judge.proofs import Proofs
from tests.simulation.judge.silence import Silence
from tests.simulation.judge.verdict import require

BOOT_UP = 0x700  # COB-ID of the message with one byte 00h, without the node id
TICK = 0.01  # [s], period of the executor's loop
EVERY = 0.05 + 2 * TICK  # [s], longest time between two snapshots of a loop that is not late
SEEN_WITHIN = 0.02  # [s] from a change at the boards to the executor: a TPDO behind others on a slow bus, and a wake-up
READ_AGAIN = 0.3  # [s] in which a read that proves nothing to the executor is repeated
# Warnings that need no disturbance. All others, and all faults, need a cause.
STANDING = frozenset({"degraded", "unknown-position", "board-limits", "outputs-off"})


class Snapshots:
    """Judges the snapshots of one executor."""

    def __init__(self, account: Account, silence: Silence, proofs: Proofs) -> None:
        self._a, self._silence, self._proofs = account, silence, proofs
        self.begin()

    def begin(self) -> None:
        self.claims: list[Callable[[Snapshot], None]] = []
        self.epoch_causes = 0
        self.locks_asked = 0
        self._shown_at = self._read_at = self._a.now
        self.boots = 0
        self._restarted = 0  # mask of the actuators whose board has restarted since the arm became ready

    def hears(self, bus: str, cob_id: int, data: bytes) -> None:
        """The process hears a frame; a boot-up message tells of a restart."""
        if cob_id & 0x780 == BOOT_UP and data == b"\0":
            board = f"{bus}/{cob_id & 0x7F}"
            self._restarted |= mask_of(k for k, name in enumerate(self._a.arm.board_of) if name == board)

    def expect_changed(self, epoch: int, text: str) -> None:
        """Requires that the next snapshot has another mode than ready, or another epoch."""
        a = self._a

        def holds(snapshot: Snapshot) -> None:
            changed = snapshot.epoch != epoch or snapshot.mode not in ("ready", "executing")
            require(changed or not a.clear, f"{text}, but the next snapshot has this epoch in mode {snapshot.mode}")

        self.claims.append(holds)

    def expect_mode(self, modes: tuple[str, ...], text: str) -> None:
        """Requires that the next snapshot has one of these modes."""
        a = self._a

        def holds(snapshot: Snapshot) -> None:
            require(snapshot.mode in modes or not a.clear, f"{text}, but the next snapshot has mode {snapshot.mode}")

        self.claims.append(holds)

    def judge_states(self, measured: bytes, known: bytes, text: str, at: float | None = None) -> None:
        """Judges states that were measured now, or since a time [s], in a world without disturbances."""
        a = self._a
        told, sure = unpack(measured), unpack(known)
        if a.mode in ("ready", "executing"):
            homed = 0 if a.shown is None else a.homing & a.ground.came_since(a.shown.at - SEEN_WITHIN)
            right = (sure ^ (a.arm.everything & ~a.homing)) & ~homed == 0
            require(right, f"{text} tells {sure:b} as known, {a.homing:b} is not")
        since = (a.now if at is None else at) - SEEN_WITHIN
        readings, states = a.ground.readings_since(since), a.ground.states_since(since)
        both = [a.arm.measured(r.extended, r.contracted, s) for r in readings for s in states]
        ever, always = 0, -1
        for measured_ in both:
            ever, always = ever | measured_, always & measured_
        skipped = a.locked & ~a.arm.sensed
        wrong = (told & ~ever | ~told & always) & sure & ~skipped
        require(not wrong, f"{text} measures {told:b}; {wrong:b} is not so, the end-stops tell {both}")
        wrong = (told ^ a.locked_states) & skipped & sure
        require(not wrong, f"{text} measures {told:b}; {wrong:b} are locked otherwise")

    def show(self, snapshot: Snapshot) -> None:
        a, last = self._a, self._a.shown
        require(abs(snapshot.at - a.now) < EPSILON, f"a snapshot of {snapshot.at:g} is sent at {a.now:g}")
        if last is not None:
            require(snapshot.epoch >= last.epoch, f"the epoch falls from {last.epoch} to {snapshot.epoch}")
            require(snapshot.locks >= last.locks, f"the locks' number falls from {last.locks} to {snapshot.locks}")
        before = "starting" if last is None else last.mode
        if snapshot.mode in ("ready", "executing") and before not in ("ready", "executing"):
            a.ready_at = a.now
            self.boots += 1
            self.epoch_causes += 1
        if snapshot.mode == "fault" != before:
            self.epoch_causes += 1
        if last is not None:
            grows = snapshot.epoch > last.epoch
            if grows and not self.epoch_causes and self._silence.due:
                self._silence.notice()
                self.epoch_causes += 1
            require(grows or not self.epoch_causes, f"the epoch is still {last.epoch}, {self.epoch_causes} causes")
        if last is not None and a.clear:
            self._judge_changes(last, snapshot)
        a.shown = snapshot
        self._take_locks(last, snapshot)
        self._take_unknown(snapshot)
        if a.clear:
            self._judge(snapshot, before)
        self.epoch_causes = self.locks_asked = 0
        claims, self.claims = self.claims, []
        for claim in claims:
            claim(snapshot)
        self._shown_at = a.now

    def tick(self) -> None:
        """Finds missing snapshots."""
        a = self._a
        if not self._silence.connected or not a.clear:
            self._shown_at = self._read_at = a.now
        require(a.now - self._shown_at <= EVERY, f"no snapshot for {a.now - self._shown_at:g} s")

    def _take_locks(self, last: Snapshot | None, snapshot: Snapshot) -> None:
        a = self._a
        a.locked = unpack(snapshot.locked)
        blind = a.locked & ~a.arm.sensed & unpack(snapshot.known)
        wrong = (unpack(snapshot.measured) ^ a.asked_states) & blind
        require(not wrong, f"{blind:b} are locked in {a.asked_states:b}, and {unpack(snapshot.measured):b} is told")
        if last is None or snapshot.locks != last.locks or a.ready_at == a.now:
            a.locked_states = unpack(snapshot.measured) & a.locked
            a.locks_changed_at = a.now

    def _take_unknown(self, snapshot: Snapshot) -> None:
        """Finds out whose states nobody can know after a boot; in a world with faults the executor tells it."""
        a, arm = self._a, self._a.arm
        homing = unpack(snapshot.homing)
        if a.ready_at == a.now:
            known = a.ground.on | arm.everything & ~arm.paired
            for reading in a.ground.readings_since(a.now - SEEN_WITHIN):
                known |= arm.definite(reading.extended, reading.contracted)
            lost, self._restarted = self._restarted & arm.paired & ~known & ~a.locked, 0
            require(not lost & ~homing, f"the boards of {lost:b} have restarted, {homing:b} are to be homed")
            # A pulse that nobody reads back counts once the board was heard, up to a heartbeat later.
            a.unknown = (a.unknown | homing & self._proofs.forgone & mask_of(arm.pulse)) & ~known
            a.knows_unknown = a.clear
        if not a.clear:
            a.unknown, a.knows_unknown = homing | a.locked & arm.paired, False
        elif not a.knows_unknown:
            a.unknown |= homing & ~a.ground.came_since(a.now - SEEN_WITHIN)

    def _judge_changes(self, last: Snapshot, snapshot: Snapshot) -> None:
        grows = snapshot.epoch > last.epoch
        require(
            grows == (self.epoch_causes > 0),
            f"the epoch is {snapshot.epoch} after {last.epoch}, {self.epoch_causes} causes",
        )
        if not self.locks_asked:
            require(snapshot.locked == last.locked, f"{unpack(snapshot.locked):b} are locked without a request")
        if snapshot.locked != last.locked:
            require(snapshot.locks > last.locks, f"other actuators are locked under the same number {last.locks}")

    def _judge(self, snapshot: Snapshot, before: str) -> None:
        a, mode = self._a, snapshot.mode
        require(unpack(snapshot.sensed) == a.arm.sensed, f"sensed is {unpack(snapshot.sensed):b}")
        homing = unpack(snapshot.homing)
        fresh = a.ground.came_since(a.now - SEEN_WITHIN)
        require(not homing & ~(a.unknown | fresh), f"{homing:b} are to be homed, unknown are {a.unknown:b}")
        if mode in ("ready", "executing") and a.knows_unknown:
            lasting = a.unknown & ~a.locked & ~fresh
            require(not lasting & ~homing, f"{homing:b} are to be homed, unknown are {a.unknown:b}")
        for fault in snapshot.faults:
            require(fault.code in STANDING, f"{fault} without a cause")
        require(mode != "fault", f"the mode is fault without a cause: {snapshot.reason}")
        if mode in ("ready", "executing"):
            self._judge_outputs(snapshot, homing)
            self.judge_states(snapshot.measured, snapshot.known, "a snapshot")
            self._judge_unread(unpack(snapshot.unread), self._proofs.unread)
            self._judge_moving(snapshot)
        degraded = sum(fault.code == "degraded" for fault in snapshot.faults)
        require(degraded == a.locked.bit_count(), f"{degraded} warnings of locks, {a.locked:b} are locked")
        if mode in ("ready", "executing"):
            unknown = [fault.message for fault in snapshot.faults if fault.code == "unknown-position"]
            told = bool(homing) == (len(unknown) == 1) and all(
                f"homes {homing.bit_count()} actuator" in it for it in unknown
            )
            require(told, f"the warnings of unknown positions are {unknown}, homing is {homing:b}")
        number = -1 if a.run is None else a.run.number
        require(snapshot.program == number, f"program {snapshot.program} is shown, {number} runs")
        require(snapshot.mark == (-1 if a.run is None else a.run.mark), f"mark {snapshot.mark} is shown")
        stream = -1 if a.stream is None else a.stream.message.stream
        if not a.quitting:
            require(snapshot.stream == stream, f"stream {snapshot.stream} is shown, {stream} is followed")
            runs = number >= 0 or stream >= 0
            require((mode == "executing") == runs, f"the mode is {mode}, program {number}, stream {stream}")

    def _judge_unread(self, told: int, so: int) -> None:
        """Judges what is told as not read back; a read that a frame may have overtaken is repeated."""
        now = self._a.now
        require(not so & ~told, f"{told:b} are told as not read back, and {so:b} are not")
        if not told & ~so:
            self._read_at = now
        late = now - self._read_at
        require(late <= READ_AGAIN, f"{told:b} are told as not read back for {late:g} s, and {so:b} are not")

    def _judge_outputs(self, snapshot: Snapshot, homing: int) -> None:
        a, told = self._a, unpack(snapshot.outputs)
        ever, always = 0, -1
        for states in a.ground.states_since(a.now - SEEN_WITHIN):
            ever, always = ever | states, always & states
        wrong = (told & ~ever | ~told & always) & a.arm.everything & ~homing & ~(a.unknown & a.locked)
        require(not wrong, f"outputs {told:b} are shown, the boards drive {a.ground.states:b}")

    def _judge_moving(self, snapshot: Snapshot) -> None:
        a, now, ground = self._a, self._a.now, self._a.ground
        last = max(ground.switched_at)
        if not snapshot.moving:
            moving = ground.surely_moving(now) if now - last > SEEN_WITHIN else 0
            begun = sum(1 << k for k in range(a.arm.count) if ground.switched_at[k] > a.ready_at)
            late = [k for k in range(a.arm.count) if moving & ~begun & 1 << k and ground.due(k) > snapshot.free_at]
            require(not late, f"{late} travel since before the end of the boot, and free_at is {snapshot.free_at:.6f}")
            moving &= begun
            require(not moving, f"nothing is shown as moving, {moving:b} travel")
        else:
            rest = ground.surely_at_rest(now, SEEN_WITHIN + TICK)
            require(not rest, "something is shown as moving, and all have arrived")
        if now - last > SEEN_WITHIN and last > a.ready_at:
            least = max(ground.due(k) for k in range(a.arm.count) if ground.switched_at[k] == last)
            require(snapshot.free_at >= least - EPSILON, f"free_at is {snapshot.free_at:.6f}, {least:.6f} at least")
        last = max(last, self._proofs.heard_at, a.ready_at, a.locks_changed_at)
        most = last + max(map(max, a.arm.travel)) + SEEN_WITHIN
        require(snapshot.free_at <= most, f"free_at is {snapshot.free_at:.6f}, {most:.6f} at most")
