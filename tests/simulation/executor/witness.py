"""Who sees what the executor's process takes and does."""

from __future__ import annotations

from hyperbit.controller.executor.core.events import ClientId, Event
from hyperbit.controller.program import Up
from hyperbit.drivers.canopen.wire.cia301 import Frame


class Witness:
    """Sees what an executor takes and does; by default it sees nothing."""

    def started(self) -> None:
        """Is called after the start of a process."""

    def killed(self) -> None:
        """Is called after the end of a process."""

    def hurries(self) -> None:
        """Is called before a process that ends in order is asked to end at once."""

    def told(self, event: Event) -> None:
        """Is called before an event is handled."""

    def sends(self, bus: str, frame: Frame) -> object:
        """Called before a frame is handed out; returns what belongs to it."""

    def says(self, message: Up) -> None:
        """Is called before a message is sent, once for all its clients."""

    def tells(self, client: ClientId, message: Up) -> None:
        """Is called before a message to a client is sent, for each client."""

    def logs(self, level: int, text: str) -> None:
        """Is called with each line of the log."""

    def notifies(self, text: str) -> None:
        """Is called with each message for systemd."""


class Witnesses(Witness):
    """Several witnesses."""

    def __init__(self, *witnesses: Witness) -> None:
        self._witnesses = list(witnesses)

    def add(self, witness: Witness) -> None:
        self._witnesses.append(witness)

    def started(self) -> None:
        for witness in self._witnesses:
            witness.started()

    def killed(self) -> None:
        for witness in self._witnesses:
            witness.killed()

    def hurries(self) -> None:
        for witness in self._witnesses:
            witness.hurries()

    def told(self, event: Event) -> None:
        for witness in self._witnesses:
            witness.told(event)

    def sends(self, bus: str, frame: Frame) -> object:
        told = [witness.sends(bus, frame) for witness in self._witnesses]
        return next((one for one in told if one is not None), None)

    def says(self, message: Up) -> None:
        for witness in self._witnesses:
            witness.says(message)

    def tells(self, client: ClientId, message: Up) -> None:
        for witness in self._witnesses:
            witness.tells(client, message)

    def logs(self, level: int, text: str) -> None:
        for witness in self._witnesses:
            witness.logs(level, text)

    def notifies(self, text: str) -> None:
        for witness in self._witnesses:
            witness.notifies(text)
