"""Commands: the RPDOs of each commit switch what was asked for, and a SYNC follows only while it is still wanted.

The RPDOs are decoded with the mappings of the boards, so each command is judged before it reaches a bus, also in a
world with many faults.
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

from hyperbit.controller.program import Setpoint, Snapshot, unpack
from tests.simulation.judge.account import EPSILON, Account, Commit
from tests.simulation.judge.arm import bits_of, merged
from tests.simulation.judge.proofs import Proofs
from tests.simulation.judge.traffic import Look
from tests.simulation.judge.verdict import require

OUTPUTS, RPDO_PARAMETERS, DUMMIES = 0x6200, range(0x1400, 0x1410), 0x20
INVALID = 1 << 31  # bit of a COB-ID
KEPT_SETPOINTS = (
    12  # bad ones among them; the stages of an earlier set-point are kept while a question about it is open
)
START = 0x01  # NMT command


class Line(NamedTuple):
    """One output in the data of an RPDO: its bit there, its actuator, whether it contracts it, and its inversion."""

    bit: int
    actuator: int
    contracts: bool
    inverted: bool


class Commands:
    """Judges the commits of one executor.

    Attributes:
        suspect: mask of the actuators whose boards have missed a frame since their boot; the world sets it.

    Args:
        proofs: tells which pulses may be given again.
    """

    def __init__(self, account: Account, arm: Any, proofs: Proofs) -> None:
        self.proofs = proofs
        self.look: dict[str, Look] = {}
        self.suspect = 0
        self._a, wiring = account, arm.wiring
        self._outputs: dict[
            str, list[tuple[int, int, bool, bool]]
        ] = {}  # of each board: bit, actuator, kind, inversion
        for k, channel in enumerate(wiring.channels):
            of_board = self._outputs.setdefault(f"{channel.bus}/{channel.node}", [])
            of_board.append((channel.output, k, False, "output" in channel.inverted))
            if channel.output_off is not None:
                of_board.append((channel.output_off, k, True, "output_off" in channel.inverted))
        self._objects = {f"{node.bus}/{node.node}": node.object for node in wiring.nodes}
        self._boards = [f"{channel.bus}/{channel.node}" for channel in wiring.channels]
        self.begin()

    def begin(self) -> None:
        self._lines: dict[tuple[str, int], list[Line]] = {}  # of each RPDO, by bus and COB-ID
        self._held = deque[int](maxlen=8)  # states that were shown or commanded since the boot
        self._told = (0, 0)  # extending and contracting outputs that were commanded on
        self._setpoints = deque[Setpoint](maxlen=KEPT_SETPOINTS)
        self._mover: Commit | None = None
        self._left = set[str]()  # boards that were ordered to leave operational: they ignore RPDOs

    def order(self, bus: str, data: bytes) -> None:
        """Records an NMT command to a board."""
        board = f"{bus}/{data[1]}"
        self._left = self._left - {board} if data[0] == START else self._left | {board}

    def receive(self, message: Setpoint) -> None:
        a = self._a
        if a.shown is not None and message.epoch == a.shown.epoch:
            self._setpoints.append(message)

    def hold(self) -> None:
        """Something ends what runs: no later commit is wanted, and none whose SYNC was not handed out."""
        self._setpoints.clear()
        commit = self._a.commit
        if commit is not None and not commit.releases:
            commit.given_up = True

    def begins(self) -> None:
        """A program begins in place of what was followed."""
        self._setpoints.clear()

    def shows(self, snapshot: Snapshot) -> None:
        """Takes the outputs that the executor believes."""
        a = self._a
        if a.ready_at == a.now:
            self._held.clear()
            self._lines.clear()
            self._told = (0, 0)
        if not self._held or self._held[-1] != unpack(snapshot.outputs):
            self._held.append(unpack(snapshot.outputs))
        if snapshot.mode not in ("ready", "executing"):
            self.hold()

    def _stages(self) -> list[int]:
        """Returns the states that may be commanded now."""
        a, run = self._a, self._a.run
        if run is not None:
            stages = enumerate(run.stages)
            return [s.states for k, s in stages if k > run.taken and run.begin + s.at <= a.now + EPSILON]
        if a.clear and a.stream is not None and not a.locked and not a.homing:
            return self._due_of_setpoints()
        every = (unpack(states) for setpoint in self._alive for states in setpoint.stages)
        return [merged(a.locked, a.locked_states, states) for states in every]

    def _due_of_setpoints(self) -> list[int]:
        """Returns the due stages of set-points: the first one of a strict one, else the last one that is near enough.

        The stages of an earlier set-point from the same states may be kept, while a question about them is open.
        """
        a, due = self._a, list[int]()
        for setpoint in self._alive:
            stages, before = [unpack(states) for states in setpoint.stages], unpack(setpoint.start)
            for k, states in enumerate(stages):  # those before were begun already
                near = [later for later in stages[k:] if (later ^ before).bit_count() <= a.arm.most]
                if before == a.believed:
                    due += [states] if setpoint.strict else near[-1:]
                before = states
        return due

    @property
    def _alive(self) -> list[Setpoint]:
        """The set-points that may be followed now."""
        size, now = self._a.arm.size, self._a.now - EPSILON
        alive = self._setpoints if any(s.until >= now for s in self._setpoints) else ()
        return [s for s in alive if all(len(states) == size for states in (s.start, *s.stages))]

    @property
    def _contracts(self) -> bool:
        """Whether the arm contracts at the end of the executor."""
        return self._a.quitting and self._a.arm.contracts_at_end

    def _homes(self) -> tuple[int, int]:
        """Returns the mask of the actuators that may be brought to a state before any stage, and these states."""
        a, run = self._a, self._a.run
        states, unknown, again = a.ground.states, a.homing, self.proofs.missed | self.proofs.doubted
        if a.shown is not None:
            states = unpack(a.shown.outputs)
        if run is not None:
            mask, states = run.homes, run.homed
            mask, states = mask | again, merged(again, self.proofs.states, states)
        elif alive := self._alive:
            mask, states = unknown | again, merged(again, self.proofs.states, unpack(alive[-1].start))
        else:
            mask = unknown if self._contracts else 0
        asked = run is not None or bool(self._alive) or self._contracts
        return (mask | a.locked if asked else 0), merged(a.locked, a.locked_states, states)

    def commit(self, bus: str, cob_id: int, data: bytes) -> None:
        """Judges an RPDO that is handed out; the account has its commit."""
        a, commit = self._a, self._a.commit
        assert commit is not None
        if not self._lines:
            self._read_mappings()
        lines = self._lines.get((bus, cob_id))
        if lines is None:
            require(a.mode not in ("ready", "executing"), f"{bus}: no board has an RPDO {cob_id:03X}h")
            return
        if commit.stages is None:
            commit.stages, (commit.homing, commit.homes) = self._stages(), self._homes()
            commit.locked, commit.contracts = a.locked, self._contracts
            if commit.homing & a.arm.paired:
                a.homed_at = a.now
        mask = extends = contracts = 0
        for bit, k, is_off, inverted in (line for line in lines if self._boards[line.actuator] not in self._left):
            level = data[bit // 8] >> bit % 8 & 1 ^ inverted if bit // 8 < len(data) else 0
            mask |= 1 << k
            extends |= (level and not is_off) << k
            contracts |= (level and is_off) << k
        self._judge(bus, cob_id, mask, extends, contracts)
        commit.mask |= mask
        commit.extends |= extends
        commit.contracts_to |= contracts

    def _judge(self, bus: str, cob_id: int, mask: int, extends: int, contracts: int) -> None:
        a, commit = self._a, self._a.commit
        assert commit is not None
        assert commit.stages is not None
        paired, text = a.arm.paired, f"{bus}: RPDO {cob_id:03X}h"
        require(not extends & contracts, f"{text} commands both outputs of {extends & contracts:b}")
        on = (extends | contracts) & paired
        sure = mask & (~paired | on)  # the command tells a state of these
        ever, always = a.ground.states, a.ground.states
        for held in self._held:
            ever, always = ever | held, always & held
        other = (extends & ~ever | ~extends & always) & sure
        told = self._told
        came = on & ~a.ground.on & ~(extends & told[0] | contracts & told[1])
        self._told = tuple(
            was & ~mask | new for was, new in zip(told, (extends & paired, contracts & paired), strict=True)
        )  # type: ignore[assignment]
        changed = other | came
        if not changed:
            return
        commit.releases = False
        if commit.homing & a.arm.paired:
            a.homed_at = a.now
        commit.stages = [states for states in commit.stages if not (states ^ extends) & changed]
        if commit.stages:
            waits = commit.homing & a.homing & a.unknown
            require(not waits or not changed & ~commit.homing, f"{text} begins a stage before {waits:b} are homed")
            return
        if commit.contracts and not changed & (extends | commit.locked):
            return
        wrong = changed & ~(commit.homing & ~(commit.homes ^ extends))
        require(
            not wrong, f"{text} commands {extends & wrong:b} of {wrong:b} in mode {a.mode}, and nothing asks for it"
        )

    def _read_mappings(self) -> None:
        for name, outputs in self._outputs.items():
            look, bus = self.look[name], name.split("/")[0]
            base = self._objects.get(name, OUTPUTS)
            for index in RPDO_PARAMETERS:
                if not look.has(index) or (cob_id := look.number(index, 1)) & INVALID:
                    continue
                lines, place = self._lines.setdefault((bus, cob_id & 0x7FF), []), 0
                for i in range(look.number(index + 0x200, 0)):
                    entry = look.number(index + 0x200, 1 + i)
                    first, count = 8 * ((entry >> 8 & 0xFF) - 1), entry & 0xFF
                    if entry >> 16 == base:
                        found = [o for o in outputs if first <= o[0] < first + count]
                        lines += [Line(place + o[0] - first, *o[1:]) for o in found]
                    place += count

    def sync(self, bus: str) -> None:
        a, commit = self._a, self._a.commit
        require(commit is not None and bus in commit.open, f"{bus}: a SYNC without RPDOs")
        assert commit is not None
        require(not commit.given_up, f"{bus}: a SYNC for RPDOs that a stop, a cancel, a fault or a loss gave up")
        delay, longest = a.now - commit.at, a.arm.timing.heartbeat_timeout / 2
        require(delay <= longest + EPSILON, f"{bus}: a SYNC {delay:g} s after the RPDOs, of {longest:g} s at most")

    def sync_again(self, bus: str) -> None:
        """Judges a SYNC in place of one that could not be sent: the boards have its RPDOs."""
        commit = self._a.commit
        assert commit is not None
        wanted = any(not (commit.extends ^ states) & commit.mask for states in self._stages())
        require(wanted or not commit.given_up, f"{bus}: a SYNC again, for RPDOs that were given up")

    def switched(self, states: int, changed: int, known: int, commit: Commit | None) -> None:
        """Judges what a SYNC has switched at the boards, and the times of those of known state."""
        sure = changed & ~self.suspect
        require(commit is not None or not sure, f"a SYNC without RPDOs switched {sure:b}")
        if commit is None or not sure:
            return
        away = sure & (states ^ commit.extends)
        require(not away, f"a SYNC switched {away:b} to {states:b}, and its RPDOs command {commit.extends:b}")
        if sure & known:
            self._judge_inrush(states, sure & known, commit)
            self._judge_rest(states, sure & known)

    def energised(self, states: int, found: int, commit: Commit | None) -> None:
        """Judges the times of actuators of unknown state that a SYNC has energised; their valves may have stayed."""
        sure = found & ~self.suspect
        if commit is not None and sure:
            self._judge_inrush(states, sure, commit)
            self._judge_rest(states, sure)

    def _judge_inrush(self, states: int, sure: int, commit: Commit) -> None:
        """At most `inrush` actuators switch at once, and with a limit each stage waits for the stage before."""
        a, last = self._a, self._mover
        commit.switched |= sure
        require(commit.switched.bit_count() <= a.arm.most, f"{commit.switched:b} switch at once")
        if last is not None and last is not commit and a.arm.limited:
            pause = a.now - last.switched_at
            least = max((a.arm.travel[k][last.switched_to >> k & 1] for k in bits_of(last.switched)), default=0.0)
            require(pause >= least - EPSILON, f"{sure:b} switch {pause:g} s after the stage before, {least:g} s is due")
        self._mover, commit.switched_at, commit.switched_to = commit, a.now, states

    def _judge_rest(self, states: int, sure: int) -> None:
        a = self._a
        for k in bits_of(sure):
            pause, state = a.now - a.ground.synced_at[k], states >> k & 1
            before = a.ground.synced_to.get(k, 1 - state)  # the same state again, if its last pulse was missed
            a.ground.synced_to[k] = state
            least = a.arm.travel[k][before] + a.arm.rest if a.arm.rest else 0.0
            require(pause >= least - EPSILON, f"actuator {k} switches {pause:g} s after it switched last")
            a.ground.synced_at[k] = a.now
