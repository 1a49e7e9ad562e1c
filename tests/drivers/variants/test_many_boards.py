"""A hundred boards of mixed variants."""

from __future__ import annotations

from random import Random

from hyperbit.drivers.canopen.wiring import Channel, NodeWiring, Timing
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World
from tests.drivers.variants.cases import CASES

BOOTING = sorted({case.variant for case in CASES if not case.refused and not case.options})
SLOW = ("slow-answers", "late-boot")


def mixed(*left_out: str, each: int = 50) -> World:
    names = [name for name in (*SLOW, *(name for name in BOOTING if name not in SLOW)) if name not in left_out]
    named = [*names, "no-error-mode", "canopennode", "maker-object"]
    random = Random(1)
    places = [(bus, node) for bus in ("can0", "can1") for node in range(1, each + 1)]
    chosen = {place: named[i] if i < len(named) else random.choice(named) for i, place in enumerate(places)}
    channels = []
    for (bus, node), name in chosen.items():
        far = 64 if name == "many-outputs" else 1
        channels += [Channel(f"{bus}/{node}.{bit}", bus, node, bit, bit) for bit in (0, far)]
    makers = [NodeWiring(*place, object=0x2201) for place, name in chosen.items() if name == "maker-object"]
    return World(
        channels,
        Timing(boot_timeout=8.0),
        variants={f"{bus}/{node}": VARIANTS[name] for (bus, node), name in chosen.items()},
        error_state="device",
        nodes=tuple(makers),
    )


def boot_time(world: World) -> float:
    """Returns the simulated time until all boards are ready [s]."""
    world.run(0.05)
    world.master.boot(world.now)
    took = world.until(lambda: not world.master.booting, 60.0)
    assert world.master.outputs_known, [fault.message for fault in world.master.boot_faults]
    return took


def test_a_hundred_boards_boot_in_parallel_and_switch_together():
    world = mixed(*SLOW)
    for bus in world.buses.values():
        bus.capacity = 128  # frames, as README asks of interfaces
    took = boot_time(world)
    print(f"100 boards booted in {took:.2f} s of simulated time")
    assert took < 3.0
    assert not any(world.switches())
    ones = [1] * len(world.wiring.channels)
    world.commit(*ones, then=1.0)
    assert world.positions() == ones
    assert world.measured() == ones
    assert world.faults == []


def test_slow_and_late_boards_do_not_hold_up_each_other():
    world = mixed(each=15)
    took = boot_time(world)
    print(f"30 boards, slow and late ones among them, booted in {took:.2f} s of simulated time")
    assert took < 45.0


if __name__ == "__main__":
    print(f"without slow ones: {boot_time(mixed(*SLOW)):.2f} s; with them: {boot_time(mixed()):.2f} s")
