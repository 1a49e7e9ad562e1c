"""Faults of buses and boards, and a log that reports each one once."""

from __future__ import annotations

from dataclasses import dataclass


class BusError(Exception):
    """A CAN bus could not be opened."""


class Busy(Exception):
    """A commit is refused: another one runs, or a bus or a board is not ready."""


@dataclass(frozen=True)
class ArmFault:
    """A fault of the arm: of its boards, buses and actuators, or of the executor.

    The master reports the codes "board-missing", "board-lost", "board-rebooted", "board-stopped", "wrong-device",
    "wrong-length", "sdo-refused", "sdo-unanswered", "emergency", "bus-off", "bus-down", "bus-busy", "bus-passive",
    "foreign-master", "not-verified", "duplicate-node" and "halted". The executor adds "stuck", "unexpected-motion",
    "pulse-overdue" and others.
    """

    code: str
    source: str  # a board ("can0/5"), a bus ("can0") or an actuator ("5.left (can0/5 output 0)")
    message: str  # a sentence for the user


def board_error(board: str, text: str) -> ArmFault:
    """Returns the fault of a board whose error register is set; `text`: what was read from it."""
    return ArmFault("board-error", board, f"board {board} reports an error: {text}. {remedy(board)}")


def left_operational(board: str, seen: str) -> str:
    """Returns the sentence for a board that left the state operational; `seen`: when, and its state now."""
    return f"board {board} left the state operational {seen}: read its errors. {remedy(board)}"


def remedy(board: str) -> str:
    """Returns what to do about an error of a board."""
    command = f"hyperbit board ARM.yaml {board} reset --communication"
    return f"Remove the cause, then reset. If there is none, stop the executor, and: {command}"


class FaultLog:
    """Faults that the caller has not taken yet. Each pair of code and source is reported once, until `clear`.

    A limit is needed: a board can send 65,280 different emergencies, 8,000 a second.
    """

    def __init__(self) -> None:
        self._reported: set[tuple[str, str]] = set()
        self._new: list[ArmFault] = []

    def report(self, fault: ArmFault) -> None:
        """Adds a fault, unless one of its code and source was reported since `clear`."""
        key = fault.code, fault.source
        if key not in self._reported:
            self._reported.add(key)
            self._new.append(fault)

    def drain(self) -> list[ArmFault]:
        new, self._new = self._new, []
        return new

    def clear(self) -> None:
        """Forgets all faults; a fault that persists is reported again."""
        self._reported.clear()
        self._new = []
