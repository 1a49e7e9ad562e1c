"""What other programs may leave on boards while no executor runs: the next boot corrects it, or refuses the board."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from tests.simulation.judge.verdict import require
from tests.simulation.statements.objects import MASTER

if TYPE_CHECKING:
    from tests.simulation.world import World

RESTARTED = 15.0  # [s] until an executor that was ended has contracted the arm, and the next one boots
REFUSED = 15.0  # [s] until a boot is over; one without answers of a board is tried again
SETTLED = 0.3  # [s] after a refusal, until the last write of it has arrived
OUTPUTS, LIVE = 0x6200, {0x1001, 0x1002, 0x1003, 0x6000}  # objects that the board changes by itself
Values = dict[tuple[int, int], int]

CORRECTED: tuple[tuple[int, int, tuple[int, ...]], ...] = (  # index, sub-index, wrong values
    (0x1005, 0, (0x85, 0x4000_0080)),
    (0x1006, 0, (1_000_000,)),
    (0x1007, 0, (10_000,)),
    (0x1019, 0, (10,)),
    (0x1014, 0, (0x8000_0081, 0xEE)),
    (0x1016, 1, (127 << 16 | 5000, 0, 3 << 16 | 1000)),
    (0x1017, 0, (0, 700, 5)),
    (0x100C, 0, (0, 500)),
    (0x100D, 0, (0, 9)),
    (0x1029, 1, (0, 1, 2)),
    (0x6005, 0, (0,)),
    (0x6006, 1, (0, 0x55)),
    (0x6006, 2, (0,)),
    (0x6208, 1, (0, 0xF0)),
    (0x6208, 2, (0,)),
    (0x1400, 1, (1 << 31 | 0x201, 0x333)),
    (0x1400, 2, (0, 2, 240, 254, 255)),
    (0x1400, 5, (200,)),
    (0x1600, 0, (0, 1, 3)),
    (0x1600, 1, (0x6200_0208,)),
    (0x1800, 1, (1 << 31 | 0x181, 0x4000_0333)),
    (0x1800, 2, (1, 254)),
    (0x1800, 3, (1000,)),
    (0x1800, 5, (0, 50)),
    (0x1A00, 0, (0, 1)),
    (0x1A00, 1, (0x6000_0208,)),
)


class Refusal(NamedTuple):
    """A board that the boot must refuse; `words` are in the sentence."""

    code: str
    words: tuple[str, ...]


class BootFaults:
    """Changes boards while the executor is dead, and judges its next boot."""

    def __init__(self, world: World, random: Random) -> None:
        self._world, self._random = world, random

    def happen(self, refused: bool) -> None:
        """Kills the executor, changes one board, and judges the boot; `refused`: which refuses the board."""
        world, random = self._world, self._random
        name = random.choice(list(world.boards.simulated.names))
        board = world.boards.simulated.board(name)
        objects, variant = board.objects, board.variant
        kept = objects.variant, objects.described, dict(objects.refused)
        world.disturb()
        found: list[Values] = []
        expected: list[Refusal] = []

        def change() -> None:
            if not board.powered or board.state is None:
                return
            self._configure_otherwise(board)
            if random.random() < 0.3:
                self._order(name)
            if refused:
                expected.append(self._spoil(name, board))
            elif random.random() < 0.3:
                board.variant = replace(variant, answer_delay=random.choice([0.01, 0.06]))
            found.append(self._values(board))

        world.executor.at_next_start(change)
        instance = world.executor.instances
        world.trouble.made["only: a refused board" if refused else "only: another configuration"] += 1
        world.note(f"{name} is changed before the boot")
        world.executor.kill()
        world.wait(lambda: world.executor.instances > instance, "started again", RESTARTED)
        if expected:
            self._judge_refusal(name, board, expected[0], found[0])
        objects.variant, objects.described, objects.refused = kept[0], kept[1], kept[2]
        board.variant = variant
        board.emergencies.recover(0xFF00)
        if board.state is State.STOPPED and not self._tells(name):
            self._command(name, Command.PRE_OPERATIONAL)  # nobody can find it: it answers no SDO
        self._invert(board, 0)
        planner = world.planner
        planner.patient = not expected  # type: ignore[union-attr]
        world.wait(world.settled, f"ready after {name} was changed", world.ready_within)
        if found and not expected:
            world.objects.judge_kept(name, found[-1], self._values(board))
        self._judge_objects()

    def _judge_objects(self) -> None:
        world = self._world
        for name in world.boards.simulated.names:
            world.objects.judge(name)

    def _configure_otherwise(self, board: Any) -> None:
        """Gives some objects wrong values, which a boot corrects."""
        objects, random = board.objects, self._random
        fixed = any(objects.variant.read_only)
        for index, sub, values in random.sample(CORRECTED, random.choice([0, 1, 3, 6])):
            entry = objects.described.get(index, {}).get(sub)
            if entry is None or not entry.writable:
                continue
            pdo = 0x1400 <= index < 0x1C00
            if pdo and (fixed or objects.variant.absent or objects.variant.changes):
                continue
            value = random.choice(values)
            if index == 0x1016 and value >> 16 == MASTER and self._watched_elsewhere(objects, sub):
                continue  # no two entries may watch one node (CiA 301)
            synchronous = index < 0x1800 and objects.variant.synchronous
            if pdo and sub == 2 and value < 254 and not synchronous:
                continue  # this board takes no such value back after a refusal
            self._world.note(f"{index:04X}h sub {sub} gets {value:X}h")
            objects.set_number(index, sub, value)
            if index == 0x1016:
                board.supervision.written(index, self._world.agenda.now)
        board.pdos.configure()

    def _watched_elsewhere(self, objects: Any, sub: int) -> bool:
        others = [k for k in range(1, 1 + objects.number(0x1016, 0)) if k != sub]
        return any(objects.number(0x1016, k) >> 16 & 0x7F == MASTER for k in others)

    def _order(self, name: str) -> None:
        """Another program stops a board, or takes it out of operational."""
        stop = Command.STOP if self._tells(name) else Command.PRE_OPERATIONAL
        self._command(name, self._random.choice([Command.PRE_OPERATIONAL, stop]))

    def _tells(self, name: str) -> bool:
        """Returns whether a board tells its state by heartbeats or node guarding, also when it is stopped."""
        objects = self._world.boards.simulated.board(name).objects
        return bool(objects.has(0x100C) or objects.number(0x1017, 0))

    def _command(self, name: str, command: Command) -> None:
        bus, node = name.split("/")
        self._world.boards.hear_tool(bus, Frame(cia301.NMT, bytes([command, int(node)])))

    def _spoil(self, name: str, board: Any) -> Refusal:
        objects, random, world = board.objects, self._random, self._world
        (outputs, inputs) = world.objects.used(name)
        sub = next(k + 1 for k in range(64) if (outputs or inputs) >> 8 * k & 0xFF)
        base = world.objects.base(name) if outputs else 0x6000
        makers = [self._error, self._unreadable, self._profile, self._unsupervised]
        if outputs and base == OUTPUTS and objects.has(0x6202) and not self._has_pairs(name):
            makers += [self._inverted] * 2
        if objects.has(0x1005):
            makers += [self._deaf] * 2
        return random.choice(makers)(board, base, sub)

    def _error(self, board: Any, base: int, sub: int) -> Refusal:
        board.emergencies.report(0xFF00, 0x80)
        return Refusal("board-error", ("1001h", "1003h", "Remove the cause"))

    def _unreadable(self, board: Any, base: int, sub: int) -> Refusal:
        board.objects.refused[base, sub] = 0x0606_0000
        return Refusal("sdo-refused", (f"{base:04X}h sub {sub}", "hardware error"))

    def _profile(self, board: Any, base: int, sub: int) -> Refusal:
        described = board.objects.described
        other = described[0x1000][0]._replace(default=(402).to_bytes(4, "little"))
        board.objects.described = {**described, 0x1000: {0: other}}
        return Refusal("wrong-device", ("1000h", "0191h"))

    def _unsupervised(self, board: Any, base: int, sub: int) -> Refusal:
        described = board.objects.described
        board.objects.described = {k: v for k, v in described.items() if k not in (0x1016, 0x100C)}
        return Refusal("wrong-device", ("1016h", "100Ch"))

    def _inverted(self, board: Any, base: int, sub: int) -> Refusal:
        self._invert(board, 0xFF)
        return Refusal("wrong-device", ("6202h", "FFh", "polarity"))

    def _has_pairs(self, name: str) -> bool:
        channels = self._world.arm.wiring.channels
        return any(c.output_off is not None for c in channels if f"{c.bus}/{c.node}" == name)

    def _invert(self, board: Any, polarity: int) -> None:
        """Writes the polarity of the outputs, which switches them."""
        objects = board.objects
        if not objects.has(0x6202) or objects.number(0x6202, 1) == polarity:
            return
        for sub in objects.subs(0x6202):
            objects.set_number(0x6202, sub, polarity)
        if board.powered:
            board.drive()
        self._world.boards.see("fault")

    def _deaf(self, board: Any, base: int, sub: int) -> Refusal:
        board.objects.variant = replace(board.objects.variant, deaf=frozenset({0x1005}))
        board.objects.set_number(0x1005, 0, 0x85)
        return Refusal("sdo-refused", ("1005h", "another program"))

    def _values(self, board: Any) -> Values:
        return {
            (index, sub): int.from_bytes(board.objects.value(index, sub), "little")
            for index, entries in board.objects.described.items()
            for sub in entries
            if index not in LIVE
        }

    def _judge_refusal(self, name: str, board: Any, expected: Refusal, found: Values) -> None:
        """Requires the fault with its words, and a board that is as it was found."""
        world = self._world

        def told() -> bool:
            snapshot = world.planner.snapshot
            return snapshot is not None and snapshot.mode == "fault"

        planner = world.planner
        planner.patient = True  # type: ignore[union-attr]
        world.wait(told, f"in mode fault: {expected}", REFUSED)
        snapshot = world.planner.snapshot
        assert snapshot is not None
        ours = [fault for fault in snapshot.faults if fault.code == expected.code and fault.source == name]
        others = [f for f in snapshot.faults if f.source.split("/")[0] in world.buses and f.source != name]
        right = len(ours) == 1 and all(word in ours[0].message for word in expected.words)
        require(right, f"{name} must be refused by {expected}, told is {snapshot.faults}")
        others = [f for f in others if f.code not in ("board-limits", "outputs-off", "bus-passive")]
        require(not others, f"only {name} has a cause for a fault, told is {others}")
        world.pass_time(SETTLED)
        before, after = found, self._values(board)
        base = world.objects.base(name)
        unread = expected.words[0].startswith(f"{base:04X}h")
        changed = {key: (value, after[key]) for key, value in before.items() if after[key] != value and key[0] != base}
        # Outputs that cannot be read may not be started: START would apply what nobody knows.
        state = world.account.ordered.get(name)
        left = board.state is state or state is None or (board.state is State.PRE_OPERATIONAL and unread)
        require(left, f"{name} was found in {state}, refused, and is left in {board.state}")
        told_ = ", ".join(f"{i:04X}h sub {s}: {a:X}h, {b:X}h now" for (i, s), (a, b) in changed.items())
        require(not changed or board.variant.saves, f"{name} was refused, and is changed: {told_}")
