"""The arms of the tests: the paper's, and a small one with other modules."""

from pathlib import Path
from typing import Any

import yaml

from tests.waiting import SLOWNESS

PLANAR = Path(__file__).parents[3] / "deploy" / "planar16.yaml"

# Of the eight codes of three bits, each motor uses five.
MOTOR = {
    "type": "revolute",
    "count": 4,
    "axis": [1, 0, 0],
    "angles": [-0.5, -0.3, -0.1, 0.1, 0.3],
    "link": {"position": [0, 0, 0.15], "orientation": [0, 0, 0.70710678, 0.70710678]},
}
SLIDE = {"type": "prismatic", "axis": [0, 0, 1], "lengths": [0.1, 0.15, 0.2, 0.25]}
GRIPPER = {"type": "transforms", "table": "gripper.csv"}
TABLE = "x,y,z,qx,qy,qz,qw\n0,0,0.05,0,0,0,1\n0.02,0,0.045,0,0.1,0,0.995\n"
BITS, BOARDS = [3, 3, 3, 3, 2, 6, 1], [[1, 2], [3, 4, 5], [6], [7]]  # bits of each module; modules of each board

# Times of the boards [s]. Boards and executor run beside tests, without real-time priority, on a busy machine. A longer
# stall loses a board. Tests of such losses use quick boards.
PATIENT = {"heartbeat": 0.1, "heartbeat_timeout": 10.0, "boot_timeout": 6.0, "settle_margin": 5.0}
MOST = {"heartbeat_timeout": 30.0, "settle_margin": 10.0}  # maxima of an arm's file
# A test takes 5 s for each lost board, and for each actuator that is stuck.
QUICK = {"heartbeat_timeout": 5.0, "boot_timeout": 3.0, "settle_margin": 5.0}  # still longer than most stalls


def planar() -> dict[str, Any]:
    """The paper's arm, with fewer boards if the machine is slow."""
    document: dict[str, Any] = yaml.safe_load(PLANAR.read_text())
    document["workspace"] = {"pixel": 0.02}
    if SLOWNESS > 1:
        for k, channel in enumerate(document["actuators"]):
            channel["node"], channel["output"] = 1 + k // 6, k % 6
            channel["input"] = channel["output"]
    return document


def mixed() -> dict[str, Any]:
    """Four motors of five positions, a slide, a platform and a measured gripper, on boards of at most twelve bits."""
    from tests.arm.test_chain import PLATFORM

    actuators: list[dict[str, Any]] = []
    for node, modules in enumerate(BOARDS, 1):
        wired = [(m, str(k + 1)) for m in modules for k in range(BITS[m - 1])]
        actuators += [
            {"module": m, "actuator": name, "bus": "can0", "node": node, "output": bit, "input": bit}
            for bit, (m, name) in enumerate(wired)
        ]
    return {
        "name": "mixed",
        "modules": [MOTOR, SLIDE, PLATFORM, GRIPPER],
        "tolerance": {"position": 0.01},
        "workspace": {"pixel": 0.025, "memory": 8},
        "buses": [{"name": "can0", "channel": "can0"}],
        "actuators": actuators,
    }


NO_BUS = {"interface": "virtual", "channel": "none"}  # of a file that is prepared, not run
KINDS = {"planar": planar, "mixed": mixed}


def write(folder: Path, kind: str, name: str, bus: dict[str, str], fields: dict[str, Any]) -> Path:
    """Writes the file of an arm, in a folder.

    Args:
        fields: replace fields of the file; those of `boards` one by one.
    """
    document = KINDS[kind]()
    boards = {**PATIENT, **fields.get("boards", {})}
    boards = {name: min(time * SLOWNESS, MOST.get(name, time * SLOWNESS)) for name, time in boards.items()}
    silence = 5.0 if "boards" in fields else 20.0  # [s] of the planner, which shares the machine
    times = {"travel_time": 0.05 * SLOWNESS, "planner_timeout": min(silence * SLOWNESS, 60.0)}
    document |= {"name": name, **times, **fields, "boards": boards}
    document["buses"] = [{"name": "can0", **bus}]
    (folder / "gripper.csv").write_text(TABLE)
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(document))
    return path
