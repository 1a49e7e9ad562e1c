"""The decoding of python-can's messages by the executor's bus, one message at a time."""

from __future__ import annotations

from typing import Any

import can

from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wire.events import Event
from hyperbit.drivers.canopen.wiring import BusWiring


class Decoder(CanBus):
    def __init__(self, settings: BusWiring) -> None:
        super().__init__(settings)
        self._message: can.Message | None = None
        self.open()
        self.poll()

    def decode(self, it: can.Message) -> list[Event]:
        self._message = it
        return list(self.poll())

    def _open(self) -> Any:
        return self

    def recv(self, timeout: float) -> can.Message | None:
        message, self._message = self._message, None
        return message
