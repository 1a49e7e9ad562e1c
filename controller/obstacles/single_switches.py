"""Proves that a single actuator switches clear of everything: tables of its mid-travel, and a kernel.

The frames and bodies of a module in mid-travel do not depend on the rest of the arm. So they are computed once for each
state and actuator of a module, in the middle of each part of the travel: the whole, its halves, their halves, and so
on. A kernel takes them from the tables and bounds the motion as swept_check does. It checks some 50,000 switches a
second, which a search in the graph of all actuator states needs. Sweep decides the few switches that pass through gaps
too narrow for the tables.
"""

from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, F5, I1, I2, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module
from hyperbit.controller.obstacles.clearance import BodyClearance, balls
from hyperbit.controller.obstacles.collision import ARM_BODIES, ArmBodies
from hyperbit.controller.obstacles.displacements import displacements_of
from hyperbit.controller.obstacles.distance import SURROUNDINGS, Array, Index, Surroundings
from hyperbit.controller.obstacles.swept_check import (
    BOX_MOTION,
    CHAINS,
    SWITCHING,
    BoxMotion,
    Chains,
    Switching,
    check_box,
    write_motion,
)

DEPTH, SHALLOW, FEW = 8, 6, 8  # most halvings of a travel; SHALLOW: above FEW different switches of modules
PARTS = 256  # most parts of a travel to check; without a result the switch stays undecided


class ModuleSwitches(NamedTuple):
    following: Index  # state after a switch, -1 if there is none or its motion is unknown, shape (K, A)
    rows: Index  # rows of a switch in the arrays below, the same in both directions, shape (K, A)
    rotations: Array  # of the frame above the module in the middle of each part, shape (E, M, 3, 3)
    translations: Array  # likewise, shape (E, M, 3)
    bodies: Array  # line segments of the module there, shape (E, M, L, 2, 3)
    rates: Array  # see Displacements.rates, shape (E, 3)


class ArmSwitches(NamedTuple):
    """The single switches of an arm, for kernels. See ModuleSwitches."""

    owners: Index  # module of each actuator, shape (A,)
    places: Index  # number of each actuator in its module, shape (A,)
    following: Index  # of each module, padded with -1, shape (B, Kmax, Amax)
    rows: Index  # likewise
    rotations: Array  # of all modules, shape (E, M, 3, 3)
    translations: Array  # shape (E, M, 3)
    bodies: Array  # padded with 0, shape (E, M, Lmax, 2, 3)
    balls: Array  # centres and radii of balls around them, shape (E, M, 4)
    rates: Array  # shape (E, 3)
    base_rotation: Array  # of the arm, shape (3, 3)
    base_position: Array  # of the arm, shape (3,)


class SwitchScratch(NamedTuple):
    """Scratch of the kernel; only one search at a time may use it."""

    chains: Chains  # the arm, as one box
    motion: BoxMotion  # of this box
    switching: Switching  # the actuator that switches
    suspects: NDArray[np.bool_]  # see swept_check
    reports: Index  # see swept_check
    waiting: Index  # parts of the travel to check, shape (n,)
    collided: NDArray[np.bool_]  # written: whether the arm collides in the middle of a part, shape (1,)


I3: Any = int64[:, :, ::1]
ARM_SWITCHES = named(ArmSwitches, I1, I1, I3, I3, F4, F3, F5, F3, F2, F2, F1)
SWITCH_SCRATCH = named(SwitchScratch, CHAINS, BOX_MOTION, SWITCHING, boolean[:, ::1], I2, I1, boolean[::1])


@lru_cache(maxsize=64)
def switches_of(module: Module, depth: int) -> ModuleSwitches:
    """Returns the cached single switches of a module, with `depth` halvings of the travel."""
    middles = np.concatenate([(np.arange(1 << d) + 0.5) / (1 << d) for d in range(depth + 1)])
    codes = {tuple(row): k for k, row in enumerate(module.bits.tolist())}
    following = np.full(module.bits.shape, -1)
    rows, rates, displacements = following.copy(), list[Array](), list[Array]()
    for (code, k), a in product(codes.items(), range(len(module.actuators))):
        other = codes.get((*code[:a], 1 - code[a], *code[a + 1 :]))
        if code[a] == 1 or other is None:
            continue
        rate = displacements_of(module).rates(np.array(code, dtype=float), np.array([a]))[0]
        if np.isfinite(rate).all():
            following[k, a], following[other, a] = other, k
            rows[k, a] = rows[other, a] = len(rates)
            rates.append(rate)
            travel = np.tile(np.array(code, dtype=float), (len(middles), 1))
            travel[:, a] = middles
            displacements.append(travel)
    shape, lines = (len(rates), len(middles)), module.body.shape[1:]
    frames, bodies = module.between(np.reshape(displacements, (-1, len(module.actuators))))
    frames, bodies = frames.reshape(*shape, 4, 4), bodies.reshape(*shape, *lines)
    return ModuleSwitches(following, rows, frames[..., :3, :3], frames[..., :3, 3], bodies, np.reshape(rates, (-1, 3)))


@lru_cache(maxsize=8)
def arm_switches(manipulator: Manipulator) -> ArmSwitches:
    """Returns the cached single switches of an arm."""
    modules = manipulator.modules
    distinct = list(dict.fromkeys(modules))
    depth = DEPTH if sum(module.bits.size for module in distinct) <= 2 * FEW else SHALLOW
    tables = [switches_of(module, depth) for module in distinct]
    firsts = dict(zip(distinct, np.cumsum([0, *(len(table.rates) for table in tables)]), strict=False))
    most, lines = max(module.bits.shape[1] for module in modules), max(module.body.shape[1] for module in modules)
    following = np.full((len(modules), manipulator.frames.shape[1], most), -1)
    rows = following.copy()
    for i, module in enumerate(modules):
        own, (states, actuators) = switches_of(module, depth), module.bits.shape
        following[i, :states, :actuators] = own.following
        rows[i, :states, :actuators] = np.where(own.rows < 0, -1, own.rows + firsts[module])
    padded = [np.pad(t.bodies, [(0, 0), (0, 0), (0, lines - t.bodies.shape[2]), (0, 0), (0, 0)]) for t in tables]
    counts = [len(module.actuators) for module in modules]
    return ArmSwitches(
        np.repeat(np.arange(len(modules)), counts),
        np.concatenate([np.arange(count) for count in counts]),
        following,
        rows,
        np.ascontiguousarray(np.concatenate([table.rotations for table in tables])),
        np.ascontiguousarray(np.concatenate([table.translations for table in tables])),
        np.concatenate(padded),
        np.concatenate([balls(table.bodies) for table in tables]),
        np.concatenate([table.rates for table in tables]),
        np.ascontiguousarray(manipulator.base[:3, :3]),
        np.ascontiguousarray(manipulator.base[:3, 3]),
    )


def lowest_modules(switches: ArmSwitches, count: int) -> ArmSwitches:
    """Returns the single switches of the lowest modules of an arm."""
    actuators = np.searchsorted(switches.owners, count)
    return switches._replace(
        owners=switches.owners[:actuators],
        places=switches.places[:actuators],
        following=switches.following[:count],
        rows=switches.rows[:count],
    )


def switch_scratch(clearance: BodyClearance, modules: int) -> SwitchScratch:
    """Returns new scratch for the lowest modules of an arm."""
    segments = clearance.bodies.shape[2]
    parts = np.zeros((1, modules, segments, 2, 3)), np.zeros((1, modules, 4)), clearance.lines[:modules]
    chains = Chains(np.zeros((1, modules + 1, 3, 3)), np.zeros((1, modules + 1, 3)), *parts)
    frames = np.zeros((modules + 1, 3, 3)), np.zeros((modules + 1, 3))
    bounds = np.zeros((3, modules))
    motion = BoxMotion(*frames, bounds[0], bounds[1], bounds[2], np.zeros((2, 2, 3)))
    switching = Switching(np.zeros(1, dtype=np.int64), np.zeros((1, 3)), np.zeros((1, 1)))
    suspects, reports = np.zeros((1, modules), dtype=bool), np.zeros((1, 3), dtype=np.int64)
    waiting, collided = np.zeros(DEPTH + 3, dtype=np.int64), np.zeros(1, dtype=bool)
    return SwitchScratch(chains, motion, switching, suspects, reports, waiting, collided)


@kernel(types.void(CHAINS, int64, F2, F1, F3, F1), **UNCOUNTED)
def put_module(chains: Chains, i: int, r: Array, b: Array, body: Array, ball: Array) -> None:
    """Writes the frame above module i and its body (L, 2, 3) with its ball (4,)."""
    for c in range(3):
        chains.translations[0, i + 1, c] = b[c]
        for d in range(3):
            chains.rotations[0, i + 1, c, d] = r[c, d]
    for n in range(chains.lines[i]):
        for c in range(3):
            chains.bodies[0, i, n, 0, c], chains.bodies[0, i, n, 1, c] = body[n, 0, c], body[n, 1, c]
    for c in range(4):
        chains.balls[0, i, c] = ball[c]


@kernel(types.void(ARM_SWITCHES, ARM_BODIES, I1, SWITCH_SCRATCH), **UNCOUNTED)
def place_arm(switches: ArmSwitches, arm: ArmBodies, configuration: Index, scratch: SwitchScratch) -> None:
    """Writes the arm in a configuration (B,)."""
    chains = scratch.chains
    for c in range(3):
        chains.translations[0, 0, c] = switches.base_position[c]
        for d in range(3):
            chains.rotations[0, 0, c, d] = switches.base_rotation[c, d]
    for i in range(len(configuration)):
        k = configuration[i]
        put_module(chains, i, arm.rotations[i, k], arm.translations[i, k], arm.bodies[i, k], arm.balls[i, k])


@kernel(boolean(ARM_SWITCHES, ARM_BODIES, SURROUNDINGS, I1, int64, SWITCH_SCRATCH), **UNCOUNTED)
def switch_is_clear(
    switches: ArmSwitches,
    arm: ArmBodies,
    surroundings: Surroundings,
    configuration: Index,
    actuator: int,
    scratch: SwitchScratch,
) -> bool:
    """Returns whether an actuator is proven to switch clear, from a configuration (B,) that place_arm has written.

    The whole travel is checked first, then the halves of each part that its bounds do not prove clear. A switch that is
    not proven clear collides if `scratch.collided`; otherwise it is undecided.
    """
    chains, motion, switching, suspects, reports, waiting, collided = scratch
    i = switches.owners[actuator]
    k, row = configuration[i], switches.rows[i, configuration[i], switches.places[actuator]]
    switching.owners[0] = i
    for c in range(3):
        switching.rates[0, c] = switches.rates[row, c]
    count, checked, clear = 1, 0, True
    collided[0] = False
    waiting[0] = 1  # part n has the halves 2 n and 2 n + 1, so it is in row n - 1
    while count > 0 and clear:
        count, checked = count - 1, checked + 1
        part = waiting[count]
        width, n = 0.5, part
        while n > 1:
            width, n = width / 2, n >> 1
        switching.half_widths[0, 0] = width
        frame = switches.rotations[row, part - 1], switches.translations[row, part - 1]
        put_module(chains, i, frame[0], frame[1], switches.bodies[row, part - 1], switches.balls[row, part - 1])
        write_motion(chains, switching, 0, motion)
        for j in range(len(configuration)):
            suspects[0, j] = j >= i
        worst, _, collides = check_box(chains, 0, motion, surroundings, suspects, reports)
        if collides or (worst >= 0 and (2 * part > len(switches.rotations[row]) or checked >= PARTS)):
            clear, collided[0] = False, collides
        elif worst >= 0:
            waiting[count], waiting[count + 1] = 2 * part, 2 * part + 1
            count += 2
    put_module(chains, i, arm.rotations[i, k], arm.translations[i, k], arm.bodies[i, k], arm.balls[i, k])
    return clear
