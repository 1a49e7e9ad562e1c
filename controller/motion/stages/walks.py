"""Kernels that walk in the graph of configurations: clear switches of single actuators are its edges."""

from typing import Any, NamedTuple

import numpy as np
from numba import boolean, int64, types

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import I1, UNCOUNTED, named
from hyperbit.controller.motion.stages.state_trees import (
    STATE_TREE,
    U1,
    Bits,
    StateTree,
    add,
    bit,
    find,
    flip,
    nearest,
    packed,
)
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.collision import ARM_BODIES, ArmBodies
from hyperbit.controller.obstacles.distance import SURROUNDINGS, Index, Surroundings
from hyperbit.controller.obstacles.single_switches import (
    ARM_SWITCHES,
    SWITCH_SCRATCH,
    ArmSwitches,
    SwitchScratch,
    arm_switches,
    lowest_modules,
    place_arm,
    switch_is_clear,
    switch_scratch,
)

ROOM = 512  # of a tree for one walk
RUNS = 5  # the mean length of a run of equal modules in a target is 1, 2, 4, .. up to 2^(RUNS - 1)
COLLIDES, KNOWN, UNDECIDED = -1, -2, -3  # what `step` returns instead of a number
TOWARDS = 0.3  # share of the targets that are configurations of the other tree


class Walk(NamedTuple):
    """What a kernel needs to walk in the graph."""

    switches: ArmSwitches
    arm: ArmBodies
    surroundings: Surroundings
    scratch: SwitchScratch  # of switch_is_clear
    configuration: Index  # scratch, shape (B,)
    bits: Bits  # scratch, actuator states, shape (W,)
    target: Bits  # scratch, actuator states, shape (W,)
    order: Index  # scratch, shape (A,)
    random: Bits  # state of the random numbers, shape (1,)
    once: bool  # whether an actuator may switch only if that brings it to its state in `target`


WALK = named(Walk, ARM_SWITCHES, ARM_BODIES, SURROUNDINGS, SWITCH_SCRATCH, I1, U1, U1, I1, U1, boolean)
PAIR: Any = types.UniTuple(int64, 2)  # type: ignore[no-untyped-call]
TRIPLE: Any = types.UniTuple(int64, 3)  # type: ignore[no-untyped-call]


def walk_of(clearance: BodyClearance, modules: int, once: bool = False) -> Walk:
    """Returns what a kernel needs to walk with the lowest modules of an arm."""
    switches = lowest_modules(arm_switches(clearance.manipulator), modules)
    actuators = len(switches.owners)
    empty = packed(np.zeros((1, actuators), dtype=np.uint8))[0]
    return Walk(
        switches,
        clearance.arm_bodies,
        clearance.surroundings,
        switch_scratch(clearance, modules),
        np.zeros(modules, dtype=np.int64),
        empty,
        empty.copy(),
        np.zeros(actuators, dtype=np.int64),
        np.ones(1, dtype=np.uint64),
        once,
    )


@kernel(int64(U1, int64), **UNCOUNTED)
def draw(random: Bits, count: int) -> int:
    """Returns a random number from 0 to count - 1, by xorshift64* (Vigna 2016)."""
    x = random[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    random[0] = x
    return int(np.int64((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(33)) % count)


@kernel(types.void(WALK, STATE_TREE, int64), **UNCOUNTED)
def stand(walk: Walk, tree: StateTree, number: int) -> None:
    """Writes a configuration of a tree to the scratch."""
    for i in range(len(walk.configuration)):
        walk.configuration[i] = tree.configurations[number, i]
    for word in range(len(walk.bits)):
        walk.bits[word] = tree.bits[number, word]
    place_arm(walk.switches, walk.arm, walk.configuration, walk.scratch)


@kernel(int64(WALK, STATE_TREE, int64, int64, boolean), **UNCOUNTED)
def step(walk: Walk, tree: StateTree, number: int, actuator: int, proven: bool) -> int:
    """Adds the neighbour of a configuration, which the scratch has, if it is new and the switch is clear.

    Returns its number, UNDECIDED, COLLIDES, or KNOWN if no check was needed.

    Args:
        walk: the graph.
        tree: has room for one more configuration.
        number: of the configuration in the tree.
        actuator: that switches.
        proven: the sweep has proven the switch clear.
    """
    i, place = walk.switches.owners[actuator], walk.switches.places[actuator]
    state = walk.configuration[i]
    following = walk.switches.following[i, state, place]
    if following < 0:
        return KNOWN
    flip(walk.bits, actuator)
    missing = find(tree, walk.bits)
    added = KNOWN
    if missing < 0:
        if proven or switch_is_clear(
            walk.switches, walk.arm, walk.surroundings, walk.configuration, actuator, walk.scratch
        ):
            walk.configuration[i] = following
            added = add(tree, walk.configuration, walk.bits, missing, number, actuator)
            walk.configuration[i] = state
        else:
            added = COLLIDES if walk.scratch.collided[0] else UNDECIDED
    flip(walk.bits, actuator)
    return added


@kernel([PAIR(WALK, STATE_TREE, int64)], **UNCOUNTED)
def extend(walk: Walk, tree: StateTree, number: int) -> tuple[int, int]:
    """Walks from a configuration of a tree towards the target, until no switch brings it nearer.

    Returns where the walk ends, and the number of checks.
    """
    checks, moved = 0, True
    while moved and tree.counts[0] < len(tree.parents):
        stand(walk, tree, number)
        count, moved = 0, False
        for actuator in range(len(walk.order)):
            if bit(walk.bits, actuator) != bit(walk.target, actuator):
                walk.order[count] = actuator
                count += 1
        while count > 0 and not moved:
            k = draw(walk.random, count)
            actuator, count = walk.order[k], count - 1
            walk.order[k] = walk.order[count]
            added = step(walk, tree, number, actuator, False)
            checks += added != KNOWN
            if added >= 0:
                number, moved = added, True
    return number, checks


@kernel([types.void(WALK)], **UNCOUNTED)
def aim(walk: Walk) -> None:
    """Draws a target: runs of modules whose actuators are in the same states, of a random mean length.

    If each actuator is drawn by itself, the bends of a long arm nearly cancel. But a way around an obstacle needs
    configurations in which many modules in a row bend to the same side.
    """
    for word in range(len(walk.target)):
        walk.target[word] = np.uint64(0)
    length, module, states = 1 << draw(walk.random, RUNS), -1, 0
    for actuator in range(len(walk.order)):
        if walk.switches.owners[actuator] != module:
            module = walk.switches.owners[actuator]
            if actuator == 0 or draw(walk.random, length) == 0:
                states = draw(walk.random, 1 << 31)
        if (states >> (walk.switches.places[actuator] % 31)) & 1:
            flip(walk.target, actuator)


@kernel([TRIPLE(WALK, STATE_TREE, STATE_TREE, int64, int64)], **UNCOUNTED)
def grow(walk: Walk, first: StateTree, second: StateTree, rounds: int, checks: int) -> tuple[int, int, int]:
    """Grows two trees until they meet, or for about a number of checks.

    Args:
        walk: the graph.
        first: the tree from the start.
        second: the tree from the ends.
        rounds: that were made before.
        checks: after which the kernel returns.

    Returns:
        the configurations where the trees meet, -1 if they do not; the number of rounds.
    """
    while checks > 0 and max(first.counts[0], second.counts[0]) + ROOM < len(first.parents):
        rounds += 1
        tree, other = (first, second) if rounds % 2 == 1 else (second, first)
        if rounds <= 2 or draw(walk.random, 1000) < 1000 * TOWARDS:
            number = draw(walk.random, other.counts[0])
            for word in range(len(walk.target)):
                walk.target[word] = other.bits[number, word]
        else:
            aim(walk)
        grown, spent = extend(walk, tree, nearest(tree, walk.target))
        checks -= spent + 1
        for word in range(len(walk.target)):
            walk.target[word] = tree.bits[grown, word]
        met, spent = extend(walk, other, nearest(other, walk.target))
        checks -= spent + 1
        same = True
        for word in range(len(walk.target)):
            same = same and other.bits[met, word] == tree.bits[grown, word]
        if same:
            return (grown, met, rounds) if rounds % 2 == 1 else (met, grown, rounds)
    return -1, -1, rounds


@kernel([PAIR(WALK, STATE_TREE, STATE_TREE, int64)], **UNCOUNTED)
def flood(walk: Walk, tree: StateTree, other: StateTree, checks: int) -> tuple[int, int]:
    """Adds all neighbours of configurations, breadth first, for about a number of checks, or until the trees meet.

    Marks undecided switches. Returns the configurations of both trees where they meet, -1 if they do not.
    """
    room = len(tree.parents) - len(walk.order) - 1  # one more for a neighbour beyond an undecided switch
    while checks > 0 and tree.counts[1] < tree.counts[0] <= room:
        number = tree.counts[1]
        stand(walk, tree, number)
        for actuator in range(len(walk.order)):
            if not walk.once or bit(walk.bits, actuator) != bit(walk.target, actuator):
                added = step(walk, tree, number, actuator, False)
                checks -= added != KNOWN
                if added == UNDECIDED and not bit(tree.undecided[number], actuator):
                    flip(tree.undecided[number], actuator)
                if added >= 0:
                    flip(walk.bits, actuator)
                    met = find(other, walk.bits)
                    flip(walk.bits, actuator)
                    if met >= 0:
                        return added, met
        tree.counts[1] = number + 1
    return -1, -1


@kernel([int64(WALK, STATE_TREE)], **UNCOUNTED)
def next_undecided(walk: Walk, tree: StateTree) -> int:
    """Returns the next undecided switch to a new configuration, -1 for none, and no longer marks it.

    The scratch has its configuration, whose number is `tree.counts[2]`.
    """
    while tree.counts[2] < tree.counts[0]:
        number = tree.counts[2]
        stand(walk, tree, number)
        for actuator in range(len(walk.order)):
            if bit(tree.undecided[number], actuator):
                flip(tree.undecided[number], actuator)
                flip(walk.bits, actuator)
                missing = find(tree, walk.bits) < 0
                flip(walk.bits, actuator)
                if missing:
                    return actuator
        tree.counts[2] = number + 1
    return -1
