"""Faults of a plant while goals run: the router dies, arms die, a name is taken twice, the network stalls."""

import sys
import time
from collections.abc import Callable

from tests.benchmarks.fleet.plant import PATIENCE, Plant
from tests.benchmarks.fleet.traffic import Traffic, ends
from tests.waiting import eventually

STALL = 10.0  # [s] that the router stands still
DEAD = 3.0  # [s] until what was killed is started again
BEFORE, AFTER = 5.0, 10.0  # [s] of goals before and after a fault


def play(plant: Plant, traffic: Traffic) -> list[str]:
    """Plays each fault while all arms have goals; returns a sentence for each on how the goals ended."""
    said: list[str] = []

    def router() -> None:
        plant.kill(["router"])
        time.sleep(DEAD)
        plant.start_router()

    def stall() -> None:
        plant.stall("router")
        time.sleep(STALL)
        plant.go_on("router")

    def arms() -> None:
        killed = plant.arms[::4]
        plant.kill(killed)
        time.sleep(DEAD)
        for name in killed:
            plant.start_arm(name)
        eventually(lambda: all(plant.ready(name) for name in killed), PATIENCE)

    def same_name() -> None:
        said.append(f"  a second {plant.arms[-1]} says: {plant.same_name(plant.arms[-1])}")

    faults: dict[str, Callable[[], None]] = {
        "the router is killed and comes back": router,
        f"the network stalls for {STALL:g} s": stall,
        "each fourth arm is killed and comes back": arms,
        "a name is taken twice": same_name,
    }
    for name, fault in faults.items():
        since, unknown = len(traffic.sent), len(traffic.unknown)
        traffic.begin(plant.arms)
        time.sleep(BEFORE)
        fault()
        time.sleep(AFTER)
        traffic.end()
        lost = f", {len(traffic.unknown) - unknown} without result" if len(traffic.unknown) > unknown else ""
        said.append(f"{name}: {ends(traffic.sent[since:])}{lost}")
        print(said[-1], file=sys.stderr, flush=True)
    return said
