"""What becomes of boards while no executor runs: other programs, the supply, errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from hyperbit.drivers.canopen.wire.cia301 import Command, State
from tests.simulation.boot_faults import CORRECTED

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld
    from tests.simulation.judge.fieldbus.wires import JudgedBoard

MORE = (
    (0x1016, 1, (127 << 16 | 30_000, 127 << 16, 5 << 16 | 100)),
    (0x1017, 0, (200, 400)),
    (0x1029, 1, (0, 1, 2)),
    (0x6207, 1, (0xFF, 0x0F)),
    (0x6207, 2, (0xFF,)),
    (0x6206, 1, (0, 0xFF, 0x55)),
    (0x6206, 2, (0, 0xFF, 0xAA)),
    (0x6206, 8, (0, 0xFF)),
    (0x1400, 1, (1 << 31 | 0x201, 0x401)),
    (0x1600, 0, (0, 7)),
    (0x1A00, 0, (0, 7)),
)
HARDWARE_ERROR = 0x0606_0000


def happen(world: BoardWorld, name: str) -> None:
    random, board = world.random, world.site.board(name)
    kind = random.choice(
        ["objects"] * 4 + ["state"] * 3 + ["supply", "error", "refuses", "deaf", "silent", "outputs", "other", "other"]
    )
    if board.state in (None, State.STOPPED) and kind in ("objects", "outputs", "state"):
        return  # it takes no SDO
    world.made[f"changed: {kind}"] += 1
    world.note(f"{name} is changed: {kind}")
    if kind == "objects":
        _objects(world, board, world.wiring.boards[name])
    elif kind == "state":
        world.site.order(name, random.choice([Command.STOP, Command.PRE_OPERATIONAL, Command.RESET_COMMUNICATION]))
        if random.random() < 0.4:
            _objects(world, board, world.wiring.boards[name])
    elif kind == "supply":
        world.site.boards.fault("power_cut", name)
        world.pass_time(0.05)
        world.site.boards.fault("power_on", name)
    elif kind == "error":
        board.emergencies.report(*random.choice([(0xFF00, 0x80), (0x5000, 0x01), (0x2310, 0x03), (0x4200, 0x08)]))
    elif kind == "refuses":
        judged = world.wiring.boards[name]
        places = [(0x1001, 0), (0x1005, 0), (0x1018, 1), (0x1400, 2)]
        places += [(0x6000, sub) for sub in (1,) if judged.sensed & 0xFF]
        places += [(judged.base, sub) for sub in (1,) if judged.used & 0xFF] * 2
        place = random.choice(places)
        if not (place[0] == 0x1400 and not judged.used) and board.objects.has(place[0]):
            board.objects.refused[place] = HARDWARE_ERROR
    elif kind == "deaf":
        _deaf(world, board)
    elif kind == "silent":
        if random.random() < 0.5:
            world.site.boards.fault("silence", name)
        else:
            world.site.boards.fault("power_cut", name)
    elif kind == "outputs":
        judged = world.wiring.boards[name]
        for sub in board.objects.subs(judged.base):
            board.objects.set_number(judged.base, sub, random.getrandbits(8) & random.getrandbits(8))
            board.outputs.written(judged.base, sub)
        board.drive()
        world.site.boards.see("foreign")
    else:
        described = board.objects.described
        other = described[0x1000][0]._replace(default=random.choice([402, 0x0003_0192]).to_bytes(4, "little"))
        board.objects.described = {**described, 0x1000: {0: other}}


def _objects(world: BoardWorld, board: Any, judged: JudgedBoard) -> None:
    objects, random = board.objects, world.random
    for index, sub, values in random.sample((*CORRECTED, *MORE), random.choice([1, 1, 2, 4, 7])):
        entry = objects.described.get(index, {}).get(sub)
        if entry is None or not entry.writable:
            continue
        pdo = 0x1400 <= index < 0x1C00
        if pdo and (objects.variant.read_only or objects.variant.changes or not objects.variant.synchronous):
            continue
        if index == 0x6207 and not judged.used >> 8 * (sub - 1) & 0xFF:
            continue  # START would switch off what is not used
        value = random.choice(values)
        if index == 0x6207:
            value &= judged.used >> 8 * (sub - 1) & 0xFF
        if (index, value) == (0x1017, 5):
            continue  # SDOs delay them so far that they tell an earlier state
        watching = [objects.number(0x1016, other) for other in objects.subs(0x1016) if other != sub]
        if index == 0x1016 and any(entry >> 16 == value >> 16 for entry in watching):
            continue  # CiA 301 forbids a second one
        world.note(f"{board.node}: {index:04X}h sub {sub} gets {value:X}h")
        objects.set_number(index, sub, value)
        if board.powered and board.state is not None:
            board.outputs.written(index, sub)
            board.supervision.written(index, world.agenda.now)
    board.pdos.configure()
    if board.state is not None:
        board.drive()
        world.site.boards.set_timer()
    world.site.boards.see("foreign")


def _deaf(world: BoardWorld, board: Any) -> None:
    objects, random = board.objects, world.random
    index, sub, value = random.choice(
        [(0x1005, 0, 0x85), (0x1006, 0, 1000), (0x1029, 1, 1), (0x6005, 0, 0), (0x1007, 0, 7)]
    )
    if not objects.has(index):
        return
    objects.variant = replace(objects.variant, deaf=objects.variant.deaf | {index})
    objects.set_number(index, sub, value)


def mend(world: BoardWorld) -> None:
    for name in world.looks:
        board = world.site.board(name)
        board.objects.refused.clear()
        board.objects.variant = world.drawn.variants[name]
        board.objects.described = world.drawn.variants[name].objects
        world.site.boards.fault("unsilence", name)
        world.site.boards.fault("power_cut", name)
        world.pass_time(0.02)
        world.site.boards.fault("power_on", name)
    world.pass_time(0.02)
