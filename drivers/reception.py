"""What becomes of the frames that are heard on one bus."""

from __future__ import annotations

import threading
from collections.abc import Iterable

import can
import canopen

from drivers import cia301
from drivers.faults import Fault, FaultLog
from drivers.layout import Layout
from drivers.node import Node
from drivers.wiring import MASTER


class Reception:
    """Hands the frames of one bus to its boards, and tells of other masters. The reader's of that bus.

    Args:
        bus: its name.
        layout: of all buses.
        nodes: the boards of all buses.
        network: whose SDO clients wait for answers on this bus.
        news: notified with every frame of a board, and held while it is taken in.
        faults: takes what is wrong.
    """

    def __init__(
        self,
        bus: str,
        layout: Layout,
        nodes: Iterable[Node],
        network: canopen.Network,
        news: threading.Condition,
        faults: FaultLog,
    ) -> None:
        self._bus, self._network, self._news, self._faults = bus, network, news, faults
        self._nodes = {node.board.node: node for node in nodes if node.board.bus == bus}
        self._masters = {cia301.NMT: "NMT", cia301.SYNC: "SYNC", cia301.HEARTBEAT + MASTER: "the master's heartbeat"}
        self._masters |= {frame.cob_id: "an RPDO" for frame in layout.frames if frame.bus == bus}

    def take(self, message: can.Message) -> bool:
        """Takes a standard data frame; returns whether it meant something."""
        cob_id, data = message.arbitration_id, bytes(message.data)
        if cob_id in self._masters:
            frame = f"{self._masters[cob_id]}, frame {cob_id:03X}h"
            text = f"another master sends on {self._bus} ({frame}): stop it, only one may switch the boards"
            self._faults.report(Fault("foreign-master", self._bus, text))
            return True
        function, number = cia301.split(cob_id)
        if (node := self._nodes.get(number)) is None:
            return False
        if function == cia301.SDO_ANSWER:
            if len(data) != 8:  # what the SDO client expects
                return False
            self._network.notify(cob_id, message.data, message.timestamp)
        with self._news:
            understood, fault = node.receive(function, data)
            self._news.notify_all()
        if fault is not None:
            self._faults.report(fault)
        return understood
