"""What happened to a board before a boot, from the arm's first boot to the end of its executor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

from hyperbit.drivers.canopen.wire.cia301 import Command
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.enumeration.rig import BITRATE, BUS, NODE, Rig
from tests.drivers.variants.cases import Case

LOST = 1.0  # [s] after which the boards have lost the master
LONGEST_BOOT = 60.0  # [s], of a board with slow answers
SLOW = ("slow-answers", "late-boot")
OPPOSITE = {"hold": "contract", "contract": "hold"}


class Before(NamedTuple):
    """A history.

    Attributes:
        happens: takes a rig whose arm is extended and whose executor has ended.
        other_loss: whether the executor before had the other `on_loss`.
    """

    name: str
    happens: Callable[[Rig], None]
    other_loss: bool = False


def _lose_master(rig: Rig) -> None:
    rig.run(LOST)


def _cycle_power(rig: Rig) -> None:
    rig.power_cycle()
    rig.run(0.05)


def _stop(rig: Rig) -> None:
    rig.command(Command.STOP)
    rig.run(0.01)


def _leave_operational(rig: Rig) -> None:
    rig.command(Command.PRE_OPERATIONAL)
    rig.run(0.01)


def _lose_master_and_leave(rig: Rig) -> None:
    rig.run(LOST)
    _leave_operational(rig)


def _stay_operational(rig: Rig) -> None:
    """Lets the board lose its master, and stay operational in its error state."""
    rig.write(0x1029, 1, 1)
    rig.run(LOST)


HISTORIES = (
    Before("executor dead until the board lost it", _lose_master),
    Before("executor restarted at once", lambda rig: None),
    Before("board power-cycled", _cycle_power),
    Before("NMT 02h by a tool", _stop),
    Before("NMT 80h by a tool", _leave_operational),
    Before("lost, then NMT 80h by a tool", _lose_master_and_leave),
    Before("lost, and on_loss changed", _lose_master, other_loss=True),
    Before("1029h is 1, then lost", _stay_operational),
)


FIRST_START = Before("first start", lambda rig: None)  # of a board that is refused


def histories(case: Case, chosen: Iterable[Before] = HISTORIES) -> Iterator[tuple[Before, Rig]]:
    """Yields a rig for each chosen history of a board, at the moment before a boot; no executor runs."""
    name = case.variant
    far = 64 if name == "many-outputs" else 1
    two = (Channel("5.left", BUS, NODE, 0, 0, input_contracted=1), Channel("5.right", BUS, NODE, far, None))
    buses = (BusWiring(BUS, "none", BUS, BITRATE),)
    wiring = Wiring(buses, case.channels or two, **case.options)
    timing = Timing(boot_timeout=8.0 if name == "late-boot" else 2.0)
    for before in (FIRST_START,) if case.refused else chosen:
        rig = Rig(with_other_loss(wiring) if before.other_loss else wiring, timing, VARIANTS[name])
        rig.run(0.05)
        if case.foreign_holds:
            rig.write(0x6206, 1, 0xFF & ~case.foreign)
            rig.run(0.01)
        if case.refused:
            yield before, rig
            continue
        if not extended(rig):
            continue
        rig.master = None
        if case.foreign:
            rig.write(rig.variant.output_object, 1, rig.board.pins & 0xFF | case.foreign)
            rig.run(0.01)
        before.happens(rig)
        rig.wiring = wiring
        yield before, rig


def extended(rig: Rig) -> bool:
    """Boots the board and switches its actuators; returns whether the board booted.

    All actuators are extended but each second one with two coils. Pulses stay on.
    """
    master = rig.start_master()
    rig.boot()
    assert rig.until(lambda: not master.booting, LONGEST_BOOT)
    if not master.outputs_known:
        return False
    count, states = len(rig.wiring.channels), (1 << len(rig.wiring.channels)) - 1
    for i, k in enumerate(rig.wiring.paired):
        if i % 2:
            states ^= 1 << k | 1 << count + i
    rig.commit(states)
    rig.run(0.2)
    return True


def with_other_loss(wiring: Wiring) -> Wiring:
    """Returns a wiring whose actuators without pulses have the other `on_loss`."""
    channels = tuple(
        replace(c, on_loss=OPPOSITE[c.on_loss]) if c.on_loss and c.pulse is None else c for c in wiring.channels
    )
    return replace(wiring, channels=channels, on_loss=OPPOSITE[wiring.on_loss])
