"""The table of commands: each command's module, summary and example, in the groups of `hyperbit --help`."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class CommandEntry(NamedTuple):
    """One command. Its function in the module has the command's name, with _ in place of -.

    Attributes:
        module: name of its module in `hyperbit.controller.commands`.
        summary: first line of the function's docstring.
        example: a call of the command.
        omitted: values of options that may be given without one, by option.
    """

    module: str
    summary: str
    example: str
    omitted: Mapping[str, str] = MappingProxyType({})


GROUPS = {
    "Use an arm": {
        "send": CommandEntry(
            "use.send",
            "Send a goal and follow it to its result; Ctrl-C cancels the goal.",
            "hyperbit send planar16 --to 0.4,2.9",
        ),
        "watch": CommandEntry(
            "use.watch",
            "Show a running arm until Ctrl-C; print changes as lines in a pipe, and states with --json.",
            "hyperbit watch planar16",
        ),
        "fleet": CommandEntry(
            "use.fleet",
            "Show all arms of a network until Ctrl-C, also below namespaces; in a pipe or with --json print them once.",
            "hyperbit fleet",
        ),
        "cancel": CommandEntry(
            "use.requests",
            "Cancel the running goal or stream of set-points; the arm holds and accepts the next goal.",
            "hyperbit cancel planar16",
        ),
        "stop": CommandEntry(
            "use.requests",
            "Stop the arm: it holds and accepts no motion until reset. No substitute for a switch that cuts the power.",
            "hyperbit stop planar16",
        ),
        "halt": CommandEntry(
            "use.halt",
            "Stop arms of this computer, without planner and Zenoh. No substitute for a power switch.",
            "hyperbit halt",
        ),
        "reset": CommandEntry("use.requests", "Leave a stop or a fault. Nothing moves.", "hyperbit reset planar16"),
        "jog": CommandEntry(
            "use.actuators",
            "Switch single actuators, even if their states form no configuration. The arm moves.",
            "hyperbit jog planar16 5.left=extended",
        ),
        "lock": CommandEntry(
            "use.actuators",
            "Lock actuators that are stuck in a state, or unlock them with `free`. Nothing moves.",
            "hyperbit lock planar16 5.left=contracted 7.right=free",
        ),
        "obstacles": CommandEntry(
            "use.obstacles",
            "List the obstacles, or replace those that were sent before; the file's remain. Nothing moves.",
            "hyperbit obstacles planar16 --none",
        ),
        "poses": CommandEntry(
            "use.poses",
            "List the named poses of an arm, save one, or remove one; `send --pose` goes there. Nothing moves.",
            "hyperbit poses planar16 --save pick",
        ),
        "fault": CommandEntry(
            "use.fault",
            "Play a fault in the boards of a simulated arm, or end it; an arm with real boards refuses.",
            "hyperbit fault planar16 silence can0/5",
        ),
    },
    "Show, record and connect an arm": {
        "panel": CommandEntry(
            "serve.panel",
            "Serve the operator's web page, which shows and commands all connected arms, until SIGTERM.",
            "hyperbit panel",
        ),
        "record": CommandEntry(
            "serve.record",
            "Record the messages of an arm, and the requests to it, to MCAP files until SIGTERM.",
            "hyperbit record planar16",
        ),
        "replay": CommandEntry(
            "serve.replay",
            "Publish a recording again below another key prefix, or repeat its goals on a simulated arm and compare.",
            "hyperbit replay --goals recording.mcap",
        ),
        "ros2": CommandEntry(
            "serve.ros2",
            "Show an arm to a ROS 2 system as a node, without ROS on this computer, until SIGTERM.",
            "hyperbit ros2 planar16",
        ),
    },
    "Operate the daemon": {
        "run": CommandEntry(
            "operate.run",
            "Run the daemon until SIGTERM: it takes goals over Zenoh and moves the arm by an executor.",
            "hyperbit run my-arm.yaml",
            omitted={"--panel": "7480"},
        ),
        "execute": CommandEntry(
            "operate.execute",
            "Run the executor until SIGTERM: it takes motion programs from a planner and commands boards over CAN.",
            "hyperbit execute my-arm.yaml",
        ),
        "simulate": CommandEntry(
            "operate.simulate",
            "Run simulated boards on the arm's own bus, in place of the real boards, until SIGTERM.",
            "hyperbit simulate my-arm.yaml --board fixed-mapping",
        ),
        "router": CommandEntry(
            "operate.router",
            "Run a Zenoh router until SIGTERM: it connects arms, pages and commands of several computers.",
            "hyperbit router",
        ),
        "demo": CommandEntry(
            "operate.demo",
            "Run a daemon on simulated boards, send it three targets and a closed curve, and draw a picture.",
            "hyperbit demo --animation demo.gif",
        ),
        "wear": CommandEntry(
            "operate.wear",
            "Print how often each actuator has switched, and how goals ended.",
            "hyperbit wear my-arm.yaml",
        ),
    },
    "Configure arm and boards": {
        "new": CommandEntry(
            "configure.new",
            "Write a new arm's file, with comments, from options and questions. Nothing is written over.",
            "hyperbit new my-arm.yaml",
        ),
        "check": CommandEntry(
            "configure.check",
            "Check an arm's file, name each fault by its line, and sum the arm up; --bus also reads the boards.",
            "hyperbit check my-arm.yaml --bus",
        ),
        "probe": CommandEntry(
            "configure.probe",
            "Find the nodes of a CAN bus and print their identity, mapping and settings; writes nothing.",
            "hyperbit probe can0 --json",
        ),
        "node-id": CommandEntry(
            "configure.node_id",
            "Set and store a board's node id and bit rate by LSS; they apply from the next power-on.",
            "hyperbit node-id can0 5",
        ),
        "board": CommandEntry(
            "configure.board",
            "Read the errors of one board, by its executor if one runs; or reset it, while the executor is stopped.",
            "hyperbit board my-arm.yaml can0/5 errors",
        ),
        "commission": CommandEntry(
            "configure.commission",
            "Move each actuator there and back, one key press a motion; ask what was seen; propose the right wiring.",
            "hyperbit commission my-arm.yaml",
        ),
        "calibrate": CommandEntry(
            "configure.calibrate",
            "Fit the modules and the base of an arm's file to measured tips; print the residuals before and after.",
            "hyperbit calibrate my-arm.yaml samples.csv --out better.yaml",
        ),
    },
    "Study arms": {
        "plan": CommandEntry(
            "study.plan",
            "Plan a goal's file as `send` would carry it out, or search configurations for goals. Nothing moves.",
            "hyperbit plan deploy/planar16.yaml --goal 0.55,2.9,0.3",
        ),
        "design": CommandEntry(
            "study.design",
            "Search arms that reach targets with few switches and few actuators; print the best, write their files.",
            "hyperbit design shelf.yaml --arms designs",
        ),
        "fk": CommandEntry(
            "study.report",
            "Print position and orientation of the tip for a configuration.",
            "hyperbit fk deploy/planar16.yaml 4646676700771206",
        ),
        "map": CommandEntry(
            "study.report",
            "Compute the point densities of all intermediate workspaces and store them in the cache.",
            "hyperbit map deploy/planar16.yaml",
        ),
        "workspace": CommandEntry(
            "study.workspace",
            "Draw and report where an arm can reach: positions, orientations at a point, reach with locked actuators.",
            "hyperbit workspace deploy/planar16.yaml --at 0.55,2.9",
        ),
        "figure5": CommandEntry(
            "study.report",
            "Repeat the paper's experiment of section 4: three targets, three algorithms.",
            "hyperbit figure5",
        ),
        "bench": CommandEntry(
            "study.bench",
            "Compare methods of inverse kinematics on goals whose fewest switches are proven.",
            "hyperbit bench --set lattice",
        ),
    },
}
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
