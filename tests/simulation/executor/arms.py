"""Random arms: wiring, times and limits."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import Any

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Interlock, NodeWiring, Timing, Wiring
from hyperbit.drivers.simulation.buses import board_names
from hyperbit.drivers.simulation.variants import VARIANTS, Variant

# Variants of boards that boot and obey each SYNC; HOLDING only if no output must go off when the master is lost.
# rounded-guarding is left out: its life time is 40 ms where the arm's time-out is 70 ms.
ORDINARY = (
    *("standard", "one-supervision", "outputs-in-rpdo5", "many-outputs", "fixed-mapping", "saves-writes"),
    *("no-output-bit", "all-bits", "shows-error-state", "resets-outputs"),
    *("absent-unsupported", "absent-general", "logged-ends", "kept-loss", "no-emergencies", "sync-window"),
    *(
        "guarding-with-1029h",
        "guarding-with-1029h",
        "guarding-with-1029h",
        "rounded-heartbeats",
        "watched-already",
        "no-device-type",
        "many-profiles",
    ),
    "short-mapping",
    *("foreign-sync", "sync-counter", "sync-period", "masked-inputs", "padded-tpdo"),
)
HOLDING = (
    *(
        "guarding-only",
        "guarding-only",
        "guarding-only",
        "no-error-behaviour",
        "canopennode",
        "no-error-mode",
        "no-error-mode-off",
        "maker-object",
    ),
    "off-in-preoperational",
)
# They cannot map 8 bytes with dummies, so that the arm has no shared RPDO.
UNSHARED = ("fixed-mapping", "outputs-in-rpdo5", "maker-object", "short-mapping")


def draw_arm(random: Random, whole: bool = False) -> ExecutedArm:
    """Returns an arm of 2..12 actuators on 1..4 boards and 1..2 buses.

    Args:
        whole: whether a whole daemon drives it: then most arms are quick, so that many goals run.
    """
    rates = [125_000, 500_000, 1_000_000]  # [bit/s]
    buses = [BusWiring(name, "simulated", name, random.choice(rates)) for name in ("can0", "can1")]
    del buses[random.choice([1, 1, 2] if whole else [1, 2]) :]
    channels = []
    for node in range(1, random.choice([1, 2, 3, 4] if whole else [1, 2, 2, 2, 3, 4]) + 1):
        bus = buses[node % len(buses)].name
        outputs = random.sample(range(12), random.randint(1, 3) + (node == 1))
        for output in outputs:
            end_stop = output if random.random() < 0.8 else None
            channels.append(Channel(f"{node}.{output}", bus, node, output, end_stop))
    often = 0.8 if whole else 0.9
    if random.random() < often:
        pulses = random.random() < often
        channels = [draw_kind(random, channel, pulses, whole) for channel in channels]
    interlocks = draw_interlocks(random, [bus.name for bus in buses], 0.3 if whole else 0.6)
    used = {channel.bus for channel in channels} | {lock.bus for lock in interlocks}
    count = len(channels)
    wiring = Wiring(
        buses=tuple(bus for bus in buses if bus.name in used),
        channels=tuple(channels),
        on_loss="hold"
        if any(c.pulse is not None for c in channels)
        else random.choice(["hold", "hold", "contract"] if whole else ["hold", "contract"]),
        shared_rpdo=random.random() < 0.3,
        interlocks=interlocks,
    )
    heartbeat = random.choice([0.05, 0.1, 0.1] if whole else [0.02, 0.05, 0.05, 0.1, 0.1, 0.1])
    timing = Timing(
        heartbeat=heartbeat,
        heartbeat_timeout=round(3.5 * heartbeat, 3),
        boot_timeout=random.choice([0.5, 1.0]),
        travel_time=random.choice([0.02, 0.02, 0.02, 0.05, 0.2] if whole else [0.02, 0.05, 0.2]),
        settle_margin=random.choice([0.03, 0.05]),
    )
    locked = random.getrandbits(count) & random.getrandbits(count) & random.getrandbits(count)
    locked = locked if random.random() < 0.4 and locked != (1 << count) - 1 else 0
    return ExecutedArm(
        name="simulated",
        wiring=wiring,
        timing=timing,
        inrush=random.choice([None, None, 2, 3] if whole else [None, 1, 2, 3]),
        rest=random.choice([0.0, 0.0, 0.0, 0.05] if whole else [0.0, 0.0, 0.05, 0.3]),
        contract_on_stop=random.random() < (0.3 if whole else 0.45),
        locked=locked,
        locked_states=locked & random.getrandbits(count),  # with an end-stop, the executor uses its reading
        continue_on_stuck=random.random() < 0.4,
        digest=64 * "0",
    )


def draw_kind(random: Random, channel: Channel, pulses: bool, whole: bool = False) -> Channel:
    """Returns a random kind of an actuator; its second output and input are 12 bits above the first ones."""
    paired, second = random.random() < 0.6, channel.output + 12
    fields: dict[str, Any] = {"input_contracted": second} if random.random() < 0.4 else {}
    inverted = {name for name in ("input", "input_contracted") if random.random() < 0.2}
    if paired:
        fields["output_off"] = second
        if not (pulses or whole) and random.random() < 0.3:  # after a restart of the board nobody can know its state
            fields["input"] = None
            fields.pop("input_contracted", None)
        if pulses and random.random() < 0.7:
            fields["pulse"] = random.choice([0.02, 0.05, 0.2])
            if random.random() < 0.25:  # after a kill nobody can know its state
                fields["input"] = None
                fields.pop("input_contracted", None)
            blind = fields.get("input", channel.input) is None and "input_contracted" not in fields
            if blind and not whole:
                fields["pulse"] = max(fields["pulse"], 0.05)  # it is read back also after some answers were lost
    elif random.random() < 0.2:
        inverted.add("output")
    if random.random() < 0.5:
        fields["travel"] = random.choice([(0.02, 0.02), (0.1, 0.04), (0.04, 0.1)])
    if "pulse" not in fields and random.random() < 0.2:
        fields["on_loss"] = "hold"
    return replace(channel, inverted=frozenset(inverted), **fields)


def draw_interlocks(random: Random, buses: list[str], share: float) -> tuple[Interlock, ...]:
    """Returns an interlock on the first board, or on a board of its own, or none."""
    if random.random() >= share:
        return ()
    node, inverted = random.choice([1, 9]), random.random() < 0.5
    return (Interlock("door", buses[node % len(buses)], node, 30, inverted),)


UNVERIFIED = 0.1  # share of the boards that nothing reads back


def draw_boards(random: Random, arm: ExecutedArm) -> tuple[ExecutedArm, dict[str, Variant]]:
    """Returns the arm with the settings that its boards need, and the variants of its boards.

    A quarter of the arms have only standard boards. Nothing reads some boards back.
    """
    if random.random() < 0.25:
        return arm, {}
    wiring = arm.wiring
    names = ORDINARY if any(level is not None for level in wiring.loss_levels) else ORDINARY + HOLDING
    chosen = {board: random.choice(names) for board in board_names(wiring)}
    nodes = tuple(
        NodeWiring(
            board.split("/")[0],
            int(board.split("/")[1]),
            object=VARIANTS["maker-object"].output_object if name == "maker-object" else 0x6200,
            verify=random.random() >= UNVERIFIED,
        )
        for board, name in chosen.items()
    )
    shared = wiring.shared_rpdo and set(UNSHARED).isdisjoint(chosen.values())
    wiring = replace(wiring, error_state="device", nodes=nodes, shared_rpdo=shared)
    return replace(arm, wiring=wiring), {board: VARIANTS[name] for board, name in chosen.items()}
