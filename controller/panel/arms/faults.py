"""Advice for each fault, by its code; and one advice for each board."""

from collections.abc import Mapping, Sequence
from typing import Any

ITSELF = "The arm continues by itself when the cause is gone."
RESET = "Then hold Reset."

ADVICE = {
    "bus-down": f"Connect the CAN adapter, or bring its interface up. {ITSELF}",
    "bus-off": f"Check wires, termination and bit rate of the bus. {ITSELF}",
    "bus-busy": f"Check that a board is connected and that the bus is terminated. {ITSELF}",
    "bus-passive": "The bus has many errors: check wires and termination. The arm still works.",
    "board-lost": f"Check the board's supply and wires. {ITSELF}",
    "board-missing": f"Check the board's supply, wires and node id. {ITSELF}",
    "board-rebooted": "The board lost its supply for a moment: check the supply. " + RESET,
    "board-stopped": "Check the board's status lights, and read its errors by: hyperbit board. " + RESET,
    "emergency": "The board reported an emergency: check the board. " + RESET,
    "wrong-length": "Another device uses this board's node id, or its mapping was changed. " + RESET,
    "wrong-device": "Change the board or the arm's file as the message says. " + RESET,
    "sdo-refused": "Change the board or the arm's file as the message says. " + RESET,
    "board-error": "Remove the cause of the board's error. " + RESET,
    "not-switched": "An output does not follow: check the board. " + RESET,
    "pulse-overdue": "A coil may be on although its pulse is over: cut its supply if it gets hot."
    f" Check bus and board. {ITSELF}",
    "not-verified": "The board does not let its outputs be read back: check the board and its firmware. " + RESET,
    "duplicate-node": "Two boards have one node id: remove one, and give it another node id with hyperbit node-id. "
    + RESET,
    "board-changed": "Another program changed the board: stop it. " + RESET,
    "stuck": "Check that the actuator moves freely and has power, and that its end-stop works. Then hold Reset,"
    " or lock the actuator.",
    "unexpected-motion": "Something moved the arm, or an actuator lost its force: check the actuator. " + RESET,
    "end-stops": "Both end-stops read 1: repair the wire or the end-stop. " + RESET,
    "interlock": "Close the interlock. " + RESET,
    "foreign-master": "Another program drives this bus: stop it. " + RESET,
    "halted": "The computer stood still: end other programs that load it. " + RESET,
    "executor-lost": "The executor is gone. systemd restarts it; without systemd run hyperbit execute.",
    "internal-error": "A defect of hyperbit: report it with the journal. " + RESET,
    "board-limits": "The board lacks this function; the arm works without it.",
    "outputs-off": "The board may have switched outputs off itself. No action is needed; look where the arm is.",
    "clock-set": "The computer's clock was set. No action is needed.",
    "network-lost": "The Zenoh router is gone. The running goal continues.",
    "ledger-unwritten": "Free space on the disk, or correct the permissions of the ledger.",
    "ledger-damaged": "The damaged ledger was renamed. No action is needed.",
    "in-obstacle": "Remove or change the obstacle: until then the arm accepts no goal.",
    "unknown-state": "Jog single actuators until the arm is in a configuration.",
    "journal": "The switch journal was damaged: no action is needed. Or its disk cannot be written: free disk space,"
    " make the folder writable, or restart the executor.",
    "unknown-position": "The first goal moves the actuator to an end; or jog it.",
    "degraded": "The arm works without this actuator. Unlock it after the repair.",
}


def advice(code: str) -> str:
    """Returns the advice for a fault."""
    return ADVICE.get(code, "See the journal: journalctl -u hyperbit -u hyperbit-executor.")


def advised(faults: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns the faults, each with `advice`; of several faults of one source, only the first has one.

    A source whose faults do not all end by themselves needs a reset: its advice says so, whatever the first fault says.
    """
    result, codes = list[dict[str, Any]](), dict[str, list[str]]()
    for fault in faults:
        codes.setdefault(str(fault.get("source")), []).append(str(fault.get("code")))
    for fault in faults:
        of_source = codes.pop(str(fault.get("source")), [])
        result.append({**fault, "advice": common_advice(of_source)})
    return result


def common_advice(codes: Sequence[str]) -> str:
    """Returns one advice for the faults of one source; "" without faults."""
    advices = [advice(code) for code in codes]
    if not advices:
        return ""
    urgent = next((text for text in advices if text.endswith(ITSELF)), advices[0])  # what must be mended first
    resets = any("hold Reset" in text for text in advices)
    return urgent.replace(ITSELF, RESET) if resets else urgent
