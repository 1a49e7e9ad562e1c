"""Advice for each fault, by its code; and one advice for each board."""

import re
from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple

from msgspec.structs import asdict

from hyperbit.controller.messages.state import Fault


class After(Enum):
    """The consequence of a mended fault, as a sentence."""

    ITSELF = "The arm continues by itself when the cause is gone."
    RESET = "Then hold Reset."
    NOTHING = ""


class FaultAdvice(NamedTuple):
    mend: str  # what to do, in one or two sentences
    after: After

    def __str__(self) -> str:
        return f"{self.mend} {self.after.value}".rstrip()


ADVICE = {
    "bus-down": FaultAdvice("Connect the CAN adapter, or bring its interface up.", After.ITSELF),
    "bus-off": FaultAdvice("Check wires, termination and bit rate of the bus.", After.ITSELF),
    "bus-busy": FaultAdvice("Check that a board is connected and that the bus is terminated.", After.ITSELF),
    "bus-passive": FaultAdvice(
        "The bus has many errors: check wires and termination. The arm still works.",
        After.NOTHING,
    ),
    "board-lost": FaultAdvice("Check the board's supply and wires.", After.ITSELF),
    "board-missing": FaultAdvice("Check the board's supply, wires and node id.", After.ITSELF),
    "board-rebooted": FaultAdvice("The board lost its supply for a moment: check the supply.", After.RESET),
    "board-stopped": FaultAdvice(
        "Check the board's status lights, and read its errors by: hyperbit board.",
        After.RESET,
    ),
    "emergency": FaultAdvice("The board reported an emergency: check the board.", After.RESET),
    "wrong-length": FaultAdvice("Another device uses this board's node id, or its mapping was changed.", After.RESET),
    "wrong-device": FaultAdvice("Change the board or the arm's file as the message says.", After.RESET),
    "sdo-refused": FaultAdvice("Change the board or the arm's file as the message says.", After.RESET),
    "sdo-unanswered": FaultAdvice("The board lacks an object and does not say so: choose another board.", After.RESET),
    "board-error": FaultAdvice("Remove the cause of the board's error.", After.RESET),
    "not-switched": FaultAdvice("An output does not follow: check the board.", After.RESET),
    "pulse-overdue": FaultAdvice(
        "A coil may be on although its pulse is over: cut its supply if it gets hot. Check bus and board.",
        After.ITSELF,
    ),
    "not-verified": FaultAdvice(
        "The board does not let its outputs be read back: check the board and its firmware.",
        After.RESET,
    ),
    "duplicate-node": FaultAdvice(
        "Two devices have one node id: remove one, and give it another node id with hyperbit node-id.",
        After.RESET,
    ),
    "board-changed": FaultAdvice("Another program changed the board: stop it.", After.RESET),
    "stuck": FaultAdvice(
        "Check that the actuator moves freely and has power, and that its end-stop works, or lock it.",
        After.RESET,
    ),
    "unexpected-motion": FaultAdvice(
        "Something moved the arm, or an actuator lost its force: check the actuator.",
        After.RESET,
    ),
    "end-stops": FaultAdvice("Both end-stops read 1: repair the wire or the end-stop.", After.RESET),
    "interlock": FaultAdvice("Close the interlock.", After.RESET),
    "foreign-master": FaultAdvice("Another program drives this bus: stop it.", After.RESET),
    "halted": FaultAdvice("The computer stood still: end other programs that load it.", After.RESET),
    "executor-lost": FaultAdvice(
        "The executor is gone. systemd restarts it; without systemd run hyperbit execute.",
        After.NOTHING,
    ),
    "internal-error": FaultAdvice("A defect of hyperbit: report it with the journal.", After.RESET),
    "board-limits": FaultAdvice("The board lacks this function; the arm works without it.", After.NOTHING),
    "outputs-off": FaultAdvice(
        "The board may have switched outputs off itself. No action is needed; look where the arm is.",
        After.NOTHING,
    ),
    "clock-set": FaultAdvice("The computer's clock was set. No action is needed.", After.NOTHING),
    "certificate-ends": FaultAdvice("A certificate of the daemon ends soon. Renew it.", After.NOTHING),
    "network-lost": FaultAdvice("The Zenoh router is gone. The running goal continues.", After.NOTHING),
    "ledger-unwritten": FaultAdvice("Free space on the disk, or correct the permissions of the ledger.", After.NOTHING),
    "ledger-damaged": FaultAdvice("The damaged ledger was renamed. No action is needed.", After.NOTHING),
    "in-obstacle": FaultAdvice("Remove or change the obstacle: until then the arm accepts no goal.", After.NOTHING),
    "unknown-state": FaultAdvice("Jog single actuators until the arm is in a configuration.", After.NOTHING),
    "journal": FaultAdvice(
        "The switch journal was damaged: no action is needed. Or its disk cannot be written: free disk space,"
        " make the folder writable, or restart the executor.",
        After.NOTHING,
    ),
    "unknown-position": FaultAdvice(
        "The next goal homes these actuators first, a large motion; or jog them.", After.NOTHING
    ),
    "not-commissioned": FaultAdvice(
        "Commission the arm beside it, by `hyperbit commission`: it shows which actuator each output moves.",
        After.NOTHING,
    ),
    "degraded": FaultAdvice("The arm works without this actuator. Unlock it after the repair.", After.NOTHING),
}
COMMAND = re.compile(r"(?<=: )hyperbit ([a-z]+).*")
ACTIONS = {  # what the page has in place of a command, with which an advice ends
    "cancel": "press Hold now",
    "fault": "the card Play a fault",
    "jog": "the card Actuators",
    "lock": "the card Actuators",
    "obstacles": "the card Obstacles",
    "poses": "Named poses in the card Goal",
    "reset": "hold Reset",
    "watch": "the card Faults",
    "workspace": "the shaded region of the picture",
}
UNKNOWN = FaultAdvice("See the journal: journalctl -u 'hyperbit*'.", After.NOTHING)


def on_page(advice: str) -> str:
    """Returns an advice with the page's own action in place of a command, if the page has one."""
    return COMMAND.sub(lambda found: ACTIONS.get(found[1], found[0]), advice)


def advised(faults: Sequence[Fault]) -> list[dict[str, Any]]:
    """Returns the faults, each with `advice` and `reset`, whether it needs a reset.

    Of several faults of one source, only the first has an advice.

    A source whose faults do not all end by themselves needs a reset: its advice says so, whatever the first fault says.
    """
    result, codes = list[dict[str, Any]](), dict[str, list[str]]()
    for fault in faults:
        codes.setdefault(fault.source, []).append(fault.code)
    for fault in faults:
        of_source = codes.pop(fault.source, None)
        advice = "" if of_source is None else str(common_advice(of_source))
        reset = ADVICE.get(fault.code, UNKNOWN).after is After.RESET
        result.append({**asdict(fault), "advice": advice, "reset": reset})
    return result


def common_advice(codes: Sequence[str]) -> FaultAdvice:
    """Returns one advice for the faults of one source, at least one."""
    advices = [ADVICE.get(code, UNKNOWN) for code in codes]
    urgent = next((it for it in advices if it.after is After.ITSELF), advices[0])  # the fault to mend first
    return urgent._replace(after=After.RESET) if any(it.after is After.RESET for it in advices) else urgent
