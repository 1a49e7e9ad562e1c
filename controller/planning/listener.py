"""Who is told what the link to the executor hears."""

from typing import Protocol

from controller.program import Up, Welcome


class Listener(Protocol):
    """Who is told what the link hears; called from the link's thread, must not wait."""

    def welcomed(self, welcome: Welcome) -> None:
        """The executor takes this planner."""

    def heard(self, message: Up) -> None:
        """A message came."""

    def lost(self, reason: str) -> None:
        """The connection ended; called once for each `welcomed`."""


class Nobody:
    """Listens to nothing."""

    def welcomed(self, welcome: Welcome) -> None:
        """Does nothing."""

    def heard(self, message: Up) -> None:
        """Does nothing."""

    def lost(self, reason: str) -> None:
        """Does nothing."""
