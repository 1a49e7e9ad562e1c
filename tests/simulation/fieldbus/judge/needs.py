"""The objects that a boot must leave on a board, by the drivers' page."""

from __future__ import annotations

import math
from typing import Any

from tests.simulation.fieldbus.judge.outcomes import MASTER, Found, beats
from tests.simulation.fieldbus.judge.wires import INPUTS, INVALID, JudgedBoard, Look, bits_in, bytes_of
from tests.simulation.verdict import require

EVENT_TIME = 1000  # [ms] of a TPDO
WAGO = 0x21  # vendor
ROUNDING = 10  # [ms] by which boards round times
RPDOS, TPDOS = range(0x1400, 0x1440), range(0x1800, 0x1840)
Table = dict[tuple[int, int], int]


def needs_of(board: JudgedBoard, found: Found) -> tuple[Table, Table]:
    """Returns the needed values of a board, and the masks of those of which only some bits matter; without times."""
    needs: Table = {(0x1005, 0): 0x80, (0x1006, 0): 0, (0x1007, 0): 0, (0x1019, 0): 0}
    masks: Table = {(0x1005, 0): 0x7FFF_FFFF}
    needs[0x1014, 0] = 0x80 + board.node
    needs[0x1029, 1] = 2 if board.taken else 0
    if beats(found):
        needs[0x100C, 0] = needs[0x100D, 0] = 0
    elif not found.has(0x1016, 1):
        needs[0x1017, 0] = 0

    def add(index: int, sub: int, value: int, mask: int) -> None:
        needs[index, sub], masks[index, sub] = value & mask, mask

    for sub in bytes_of(board.used) if board.base == 0x6200 else ():
        shift = 8 * (sub - 1)
        used, taken = board.used >> shift & 0xFF, board.taken >> shift & 0xFF
        add(0x6208, sub, used, used)
        add(0x6206, sub, taken, used)
        if taken:
            add(0x6207, sub, board.levels >> shift & 0xFF, taken)
    for sub in bytes_of(board.sensed):
        needs[0x6005, 0] = 1
        sensed = board.sensed >> 8 * (sub - 1) & 0xFF
        add(0x6006, sub, sensed, sensed)
    return needs, masks


def judge_objects(board: JudgedBoard, found: Found, look: Look, timing: Any, as_is: bool) -> None:
    """Judges all objects of a board after its boot.

    Args:
        found: what it was before.
        look: what it is now.
        as_is: whether the boot has not written to it.
    """
    needs, masks = needs_of(board, found)
    for (index, sub), value in needs.items():
        if found.has(index, sub):
            now, mask = look.number(index, sub), masks.get((index, sub), 0xFFFF_FFFF)
            text = f"board {board.name} has {now:X}h in {index:04X}h sub {sub}; {value:X}h is needed, mask {mask:X}h"
            require((now ^ value) & mask == 0, text)
    _judge_supervision(board, found, look, timing)
    _judge_pdos(board, found, look, as_is, outputs=True)
    _judge_pdos(board, found, look, as_is, outputs=False)
    _judge_watched(board, found, look)
    _judge_kept(board, found, look, needs, masks)


def _judge_supervision(board: JudgedBoard, found: Found, look: Look, timing: Any) -> None:
    timeout, period = round(1000 * timing.heartbeat_timeout), round(1000 * timing.heartbeat)

    def near(value: int, wanted: int) -> bool:
        return abs(value - wanted) <= min(wanted // 2, max(ROUNDING, wanted // 8))

    if beats(found):
        entries = [look.number(0x1016, sub) for sub in range(1, look.number(0x1016, 0) + 1)]
        watched = [entry & 0xFFFF for entry in entries if entry >> 16 & 0x7F == MASTER]
        text = f"board {board.name} watches node 127 for {watched} ms, of {entries}; {timeout} are needed"
        require(len(watched) == 1 and near(watched[0], timeout), text)
        produced = look.number(0x1017, 0)
        require(near(produced, period), f"board {board.name} has {produced} ms in 1017h; {period} are needed")
        return
    factor = math.ceil(timing.heartbeat_timeout / timing.heartbeat)
    guard = math.ceil(timeout / factor)
    told = look.number(0x100C, 0), look.number(0x100D, 0)
    right = told[1] == factor and near(told[0], guard)
    require(right, f"board {board.name} is guarded by {told}; {guard, factor} is needed")


def _judge_pdos(board: JudgedBoard, found: Found, look: Look, as_is: bool, outputs: bool) -> None:
    first, base, used = (RPDOS, board.base, board.used) if outputs else (TPDOS, INPUTS, board.sensed)
    wanted = board.rpdos if outputs else board.tpdos
    plain = [(0x200 if outputs else 0x180) + 0x100 * i + board.node for i in range(4)]
    cob_ids = [pdo.cob_id for pdo in wanted] + plain
    carrying, others, seen = [], [], 0
    for index in (index for index in first if look.has(index)):
        cob_id = look.number(index, 1)
        if cob_id & INVALID:
            continue
        mapping = tuple(look.number(index + 0x200, 1 + k) for k in range(look.number(index + 0x200, 0)))
        bits = bits_in(mapping, base) & used
        (carrying if bits and cob_id & 0x7FF in cob_ids else others).append((index, cob_id & 0x7FF, mapping))
        seen |= bits if cob_id & 0x7FF in cob_ids else 0
    text = f"board {board.name}: {carrying} carry {seen:X}h, {used:X}h is used"
    require(seen == used, text)
    needed = 0
    for index, cob_id, mapping in carrying:
        if not bits_in(mapping, base) & used & ~needed:
            others.append((index, cob_id, mapping))
            continue
        needed |= bits_in(mapping, base) & used
        kind = look.number(index, 2)
        waits = outputs and found.synchronous and found.has(0x1005)
        right = kind in (0, 1) if waits else kind in (254, 255)
        require(right, f"board {board.name}: {index:04X}h sub 2 is {kind}")
        if outputs:
            require(
                not look.number(index, 5) or (index, 5) not in found.writable,
                f"board {board.name}: a timer in {index:04X}h",
            )
        elif not as_is and (index, 5) in found.writable:
            time = look.number(index, 5)
            require(time == EVENT_TIME, f"board {board.name}: {index:04X}h sub 5 is {time}, {EVENT_TIME} is needed")
            require(not look.number(index, 3), f"board {board.name}: an inhibit time in {index:04X}h sub 3")
        free = {(index, 1), (index + 0x200, 0), (index + 0x200, 1)} <= found.writable
        room = (index + 0x200, max((len(pdo.mapping) for pdo in wanted), default=1)) in found.writable
        if free and room and not as_is:
            right = any((pdo.cob_id, pdo.mapping) == (cob_id, mapping) for pdo in wanted)
            require(right, f"board {board.name}: {index:04X}h is {cob_id:X}h with {mapping}; {wanted} are needed")
    analog = range(0x1401, 0x1404) if found.byte(0x1018, 1) == WAGO else ()  # RPDO2 to 4 carry analog outputs
    taken = [index for index, _, _ in carrying if index in analog]
    require(not taken, f"board {board.name}: {taken} are for analog outputs")
    used_ids = [cob_id for _, cob_id, _ in carrying]
    if wanted and not as_is:
        twice = [index for index, cob_id, _ in others if cob_id in used_ids]
        require(not twice, f"board {board.name}: {twice} have a COB-ID of {used_ids}")


def _judge_watched(board: JudgedBoard, found: Found, look: Look) -> None:
    """Requires that a boot spares the entries of 1016h that watch other nodes, while others are free."""
    entries = [(sub, found.byte(0x1016, sub)) for sub in range(1, 1 + found.byte(0x1016, 0))]
    free = [sub for sub, entry in entries if not entry & 0xFFFF]
    lost = [sub for sub, entry in entries if entry & 0xFFFF and entry >> 16 & 0x7F != MASTER]
    lost = [sub for sub in lost if look.number(0x1016, sub) != found.byte(0x1016, sub)]
    require(not (lost and free), f"board {board.name}: 1016h sub {lost} watched others, and sub {free} were free")


def _judge_kept(board: JudgedBoard, found: Found, look: Look, needs: Table, masks: Table) -> None:
    """Requires that all else is as before."""
    for (index, sub), value in found.values.items():
        if index in (0x1001, 0x1003, board.base, INPUTS, 0x1016, 0x1017, 0x100C, 0x100D) or 0x1400 <= index < 0x1C00:
            continue
        changed = value ^ look.number(index, sub)
        allowed = masks.get((index, sub), -1) if (index, sub) in needs else 0
        text = f"board {board.name}: {index:04X}h sub {sub} was {value:X}h, and is {look.number(index, sub):X}h now"
        require(not changed & ~allowed, text)
