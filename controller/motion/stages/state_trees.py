"""Trees of configurations that clear switches of single actuators connect, for kernels.

A configuration is stored with its actuator states as bits. An open hash table finds it by its bits.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import boolean, int32, int64, types, uint64
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import I1, S1, UNCOUNTED, named
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.distance import Index

Bits = NDArray[np.uint64]

WORD = 64
ROOT = -1  # parent of a root


class StateTree(NamedTuple):
    """A forest of configurations, with room for `capacity` of them."""

    configurations: NDArray[np.int32]  # shape (capacity, B)
    bits: Bits  # actuator states, actuator a in bit a % 64 of word a // 64, shape (capacity, W)
    parents: NDArray[np.int32]  # number of the parent, ROOT for a root, shape (capacity,)
    actuators: NDArray[np.int32]  # that switches between parent and child, shape (capacity,)
    # actuators of which flood does not know whether their switch is clear, as `bits`, shape (capacity, W)
    undecided: Bits
    slots: NDArray[np.int32]  # the hash table, numbers + 1, 0 for an empty slot; its size is a power of two
    counts: Index  # of configurations; of those that flood has visited; of those without undecided switches; shape (3,)


S2: Any = int32[:, ::1]
U1: Any = uint64[::1]
U2: Any = uint64[:, ::1]
STATE_TREE = named(StateTree, S2, U2, S1, S1, U2, S1, I1)


def state_tree(manipulator: Manipulator, modules: int, capacity: int) -> StateTree:
    """Returns an empty tree for the lowest modules of an arm. Memory is taken as it is used."""
    actuators = sum(len(module.actuators) for module in manipulator.modules[:modules])
    words, slots = -(-actuators // WORD), 1 << (2 * capacity).bit_length()
    return StateTree(
        np.zeros((capacity, modules), dtype=np.int32),
        np.zeros((capacity, words), dtype=np.uint64),
        np.zeros(capacity, dtype=np.int32),
        np.zeros(capacity, dtype=np.int32),
        np.zeros((capacity, words), dtype=np.uint64),
        np.zeros(slots, dtype=np.int32),
        np.zeros(3, dtype=np.int64),
    )


def unpacked(bits: Bits, actuators: int) -> NDArray[np.uint8]:
    """Returns the states (A,) of the first actuators from words (W,)."""
    return np.unpackbits(bits.view(np.uint8), count=actuators, bitorder="little")


def packed(states: NDArray[np.uint8]) -> Bits:
    """Returns actuator states (n, A) as words (n, W), see StateTree."""
    padded = np.pad(states, [(0, 0), (0, -states.shape[1] % WORD)])
    return np.ascontiguousarray(np.packbits(padded, axis=1, bitorder="little")).view(np.uint64)


def plant(tree: StateTree, manipulator: Manipulator, configurations: Index) -> None:
    """Adds roots: configurations (n, B) of the whole arm, cut to the modules of the tree."""
    modules = tree.configurations.shape[1]
    actuators = sum(len(module.actuators) for module in manipulator.modules[:modules])
    for configuration in np.unique(configurations[:, :modules], axis=0):
        whole = np.zeros(len(manipulator.modules), dtype=np.int64)
        whole[:modules] = configuration
        word = packed(manipulator.actuator_states(whole)[None, :actuators])[0]
        add(tree, configuration.astype(np.int64), word, find(tree, word), ROOT, 0)


def route(tree: StateTree, number: int) -> list[int]:
    """Returns the actuators that switch from a configuration up to its root."""
    found = list[int]()
    while tree.parents[number] != ROOT:
        found.append(int(tree.actuators[number]))
        number = int(tree.parents[number])
    return found


def root_of(tree: StateTree, number: int) -> int:
    """Returns the root of a configuration."""
    while tree.parents[number] != ROOT:
        number = int(tree.parents[number])
    return number


@kernel(int64(STATE_TREE, U1), **UNCOUNTED)
def find(tree: StateTree, bits: Bits) -> int:
    """Returns the number of a configuration by its bits (W,), or ~slot of the empty slot where it belongs."""
    hashed = np.uint64(0xCBF29CE484222325)
    for word in range(len(bits)):
        hashed = (hashed ^ bits[word]) * np.uint64(0x9E3779B97F4A7C15)
        hashed ^= hashed >> np.uint64(31)
    mask = len(tree.slots) - 1
    slot = int(np.int64(hashed & np.uint64(mask)))
    while tree.slots[slot] > 0:
        number = int(tree.slots[slot]) - 1
        same = True
        for word in range(len(bits)):
            same = same and tree.bits[number, word] == bits[word]
        if same:
            return number
        slot = (slot + 1) & mask
    return ~slot


@kernel(int64(STATE_TREE, I1, U1, int64, int64, int64), **UNCOUNTED)
def add(tree: StateTree, configuration: Index, bits: Bits, missing: int, parent: int, actuator: int) -> int:
    """Adds a configuration (B,) that `find` has not found; returns its number.

    Args:
        tree: has room for it.
        configuration: to add.
        bits: its actuator states (W,).
        missing: what `find` has returned.
        parent: number of its parent, or ROOT.
        actuator: that switches from the parent.
    """
    number = tree.counts[0]
    for i in range(len(configuration)):
        tree.configurations[number, i] = configuration[i]
    for word in range(len(bits)):
        tree.bits[number, word] = bits[word]
    tree.parents[number], tree.actuators[number] = parent, actuator
    tree.slots[~missing] = number + 1
    tree.counts[0] = number + 1
    return int(number)


@kernel(int64(uint64), **UNCOUNTED, inline="always")
def ones(word: int) -> int:
    """Returns the number of bits that are 1."""
    pairs = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    fours = (pairs & np.uint64(0x3333333333333333)) + ((pairs >> np.uint64(2)) & np.uint64(0x3333333333333333))
    bytewise = (fours + (fours >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int(np.int64((bytewise * np.uint64(0x0101010101010101)) >> np.uint64(56)))


@kernel(int64(STATE_TREE, U1), **UNCOUNTED)
def nearest(tree: StateTree, bits: Bits) -> int:
    """Returns the configuration that differs in the fewest actuators from bits (W,)."""
    fewest, found = 1 << 30, 0
    for number in range(tree.counts[0]):
        count = 0
        for word in range(len(bits)):
            count += ones(tree.bits[number, word] ^ bits[word])
        if count < fewest:
            fewest, found = count, number
    return found


@kernel(boolean(U1, int64), **UNCOUNTED, inline="always")
def bit(bits: Bits, actuator: int) -> bool:
    """Returns the state of an actuator in bits (W,)."""
    return bool((bits[actuator // WORD] >> np.uint64(actuator % WORD)) & np.uint64(1))


@kernel(types.void(U1, int64), **UNCOUNTED, inline="always")
def flip(bits: Bits, actuator: int) -> None:
    """Switches an actuator in bits (W,)."""
    bits[actuator // WORD] ^= np.uint64(1) << np.uint64(actuator % WORD)
