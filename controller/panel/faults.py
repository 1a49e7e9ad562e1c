"""What to do about a fault, by its code."""

ITSELF = "The arm goes on by itself when the cause is gone."
RESET = "Then hold Reset."

ADVICE = {
    "bus-down": f"Plug the CAN adapter in, or bring its interface up. {ITSELF}",
    "bus-off": f"Check wires, termination and bit rate of the bus. {ITSELF}",
    "bus-busy": f"Check that a board is connected and that the bus is terminated. {ITSELF}",
    "bus-passive": "The bus has many errors: check wires and termination. The arm still works.",
    "board-lost": f"Check the board's supply and wires. {ITSELF}",
    "board-missing": f"Check the board's supply, wires and node id. {ITSELF}",
    "board-rebooted": "The board lost its supply for a moment: check it. " + RESET,
    "board-stopped": "Look at the board's lights and errors: hyperbit board. " + RESET,
    "emergency": "The board reported an emergency: look at it. " + RESET,
    "wrong-length": "Another device uses this board's node id, or its mapping was changed. " + RESET,
    "wrong-device": "Change the board, or the arm's file, as the sentence says. " + RESET,
    "sdo-refused": "Change the board, or the arm's file, as the sentence says. " + RESET,
    "board-error": "Remove the cause of the board's error. " + RESET,
    "not-switched": "An output does not follow: check the board. " + RESET,
    "board-changed": "Another program changed the board: stop it. " + RESET,
    "stuck": "Look whether the actuator moves freely and has power, and whether its end-stop works. Then hold Reset,"
    " or lock the actuator.",
    "unexpected-motion": "Somebody moved the arm, or an actuator lost its hold: look at it. " + RESET,
    "end-stops": "Both end-stops read 1: mend the wire or switch. " + RESET,
    "interlock": "Close the interlock. " + RESET,
    "foreign-master": "Another program drives this bus: stop it. " + RESET,
    "halted": "The computer stood still: end other heavy programs. " + RESET,
    "executor-lost": "The executor is gone: systemd starts it again. Otherwise run hyperbit execute.",
    "internal-error": "A defect of hyperbit: keep the journal and report it. " + RESET,
    "board-limits": "The board cannot do this; the arm works without it.",
    "clock-set": "The computer's clock was set. Nothing is to be done.",
    "network-lost": "Zenoh's router is gone; the running goal goes on.",
    "ledger-unwritten": "Free room on the disk, or mend its rights.",
    "ledger-damaged": "The old ledger was moved aside. Nothing is to be done.",
    "in-obstacle": "Take the obstacle away, or change it: until then the arm takes no goal.",
    "unknown-state": "Jog single actuators until the arm is in a configuration.",
    "journal": "Counts of switches are not kept: free room on the disk.",
    "unknown-position": "The first goal brings the actuator to an end; or jog it.",
    "degraded": "The arm works without this actuator. Unlock it when it is mended.",
}


def advice(code: str) -> str:
    """Returns what to do about a fault."""
    return ADVICE.get(code, "See the journal: journalctl -u hyperbit -u hyperbit-executor.")
