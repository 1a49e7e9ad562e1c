"""Asks each board of a wiring what it is, and changes nothing on it."""

from __future__ import annotations

from dataclasses import dataclass

import can
import canopen

from drivers.bus import CanBus
from drivers.device_type import check_type
from drivers.layout import Board, lay_out
from drivers.sdo import BoardError, Sdo
from drivers.wiring import Wiring


@dataclass(frozen=True)
class Answer:
    """What one board said.

    Attributes:
        board: its name, e.g. "can0/5".
        ok: whether it is a CiA 401 board with what is wired to it, and reports no error.
        text: its answer, or what is wrong, in words.
    """

    board: str
    ok: bool
    text: str


def probe(wiring: Wiring) -> tuple[Answer, ...]:
    """Reads device type and error register of every board over SDO.

    Raises:
        BusError: a bus cannot be opened.
    """
    answers: list[Answer] = []
    boards = lay_out(wiring).boards
    for settings in wiring.buses:
        network = canopen.Network()

        def hand_over(message: can.Message, network: canopen.Network = network) -> bool:
            network.notify(message.arbitration_id, message.data, message.timestamp)
            return True

        bus = CanBus(settings, hand_over, lambda fault: None)
        bus.open()
        try:
            answers += [ask(board, Sdo(board, bus, network)) for board in boards if board.bus == settings.name]
        finally:
            bus.close()
    return tuple(answers)


def ask(board: Board, sdo: Sdo) -> Answer:
    """Returns the answer of one board: its device type, and its error register (1001h: CiA 301, 7.5.2.2)."""
    try:
        kind, register = check_type(board, sdo), sdo.read(0x1001, 0)
    except BoardError as error:
        return Answer(board.name, False, error.fault.message)
    return Answer(board.name, register == 0, f"device type {kind:08X}h, error register {register:02X}h")
