"""Access to the page: by token, by the cookie of a session, or by client certificate."""

import hmac
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from hyperbit.controller.panel.access.people import Person, PersonEntry, digest_of
from hyperbit.controller.panel.access.sessions import Sessions


class Access:
    """Checks tokens, cookies and names of certificates of people with distinct names. Not thread-safe.

    `file` keeps the sessions over a restart; None: they end with the process.
    """

    def __init__(
        self, people: Sequence[PersonEntry], file: Path | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._people = {entry.name: entry for entry in people}
        self._sessions = Sessions(self._people, file, clock)

    def enter(self, token: str) -> str | None:
        """Begins a session; returns its cookie, or None if the token is wrong."""
        found = self._holder(token)
        return None if found is None else self._sessions.begin(found)

    def leave(self, cookie: str | None) -> None:
        self._sessions.end(cookie)

    def bearer(self, token: str) -> Person | None:
        return described(self._holder(token))

    def person(self, cookie: str | None) -> Person | None:
        """Returns the person of a cookie; None if its session has ended or never began."""
        return described(self._sessions.entry(cookie))

    def certified(self, name: str | None) -> Person | None:
        """Returns the person with the common name of a client certificate; None if there is none."""
        return described(self._people.get(name or ""))

    def _holder(self, token: str) -> PersonEntry | None:
        """Returns the entry of a token. Its duration does not reveal how much of a token is right."""
        digest, found = digest_of(token), None
        for entry in self._people.values():
            if entry.token is not None and hmac.compare_digest(entry.token, digest):
                found = entry
        return found


def described(entry: PersonEntry | None) -> Person | None:
    return None if entry is None else Person(entry.name, entry.role, entry.stop)
