"""Who sees what the executor's process takes and does: a fact of a kind calls the method of this name, if there is one.

started(), killed(): a process has started; it has ended.
hurries(): before a process that ends in order is asked to end at once.
told(event): before an event is handled.
sends(bus, frame): before a frame is handed out; returns what belongs to the frame.
says(message), tells(client, message): before a message is sent, once for all its clients, and for each client.
logs(level, text), notifies(text): a line of the log; a message for systemd.
"""

from __future__ import annotations

from typing import Any


class Witness:
    def see(self, kind: str, *facts: Any) -> Any:
        take = getattr(type(self), kind, None)
        return None if take is None else take(self, *facts)


class Witnesses:
    """Several witnesses. The first that knows tells what belongs to a frame."""

    def __init__(self, *witnesses: Witness) -> None:
        self._witnesses = list(witnesses)

    def add(self, witness: Witness) -> None:
        self._witnesses.append(witness)

    def see(self, kind: str, *facts: Any) -> Any:
        told = [witness.see(kind, *facts) for witness in self._witnesses]
        return next((one for one in told if one is not None), None)
