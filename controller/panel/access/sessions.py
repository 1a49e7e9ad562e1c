"""Sessions of logged-in people. The server ends a session at log-out, so that a copied cookie is invalid then."""

import logging
import os
import secrets
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from hyperbit.controller.host.files import read_kept
from hyperbit.controller.host.keeper import write_whole
from hyperbit.controller.panel.access.people import PersonEntry, digest_of

log = logging.getLogger(__name__)

LASTS = 12 * 3600.0  # [s] lifetime of a session
MOST_OF_PERSON = 100  # sessions; a further log-in ends the person's oldest session


class Session(msgspec.Struct, frozen=True):
    name: str  # of the person
    until: float  # its end by CLOCK_MONOTONIC [s]
    entry: str  # digest of the person's role and token: a change of either ends the session


class Sessions:
    """The sessions. A cookie is a random text; only its SHA-256 is kept. Not thread-safe.

    `file` keeps the sessions over a restart of the process, not of the computer, with which CLOCK_MONOTONIC begins
    anew. None: they end with the process.
    """

    def __init__(
        self, people: Mapping[str, PersonEntry], file: Path | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._people, self._file, self._clock = people, file, clock
        kept = None if file is None else read_kept(file, dict[str, Session], "all people must log in")
        self._sessions = kept or {}

    def begin(self, entry: PersonEntry) -> str:
        cookie, now = secrets.token_urlsafe(32), self._clock()
        for key in [key for key, session in self._sessions.items() if session.until <= now]:
            del self._sessions[key]
        own = [key for key, session in self._sessions.items() if session.name == entry.name]
        for key in own[: max(len(own) - MOST_OF_PERSON + 1, 0)]:  # in the order of their begin
            del self._sessions[key]
        self._sessions[digest_of(cookie)] = Session(entry.name, now + LASTS, entry_digest(entry))
        self._write()
        return cookie

    def entry(self, cookie: str | None) -> PersonEntry | None:
        """Returns the entry of a cookie's person; None if its session has ended or never began."""
        session = self._sessions.get(digest_of(cookie or ""))
        entry = None if session is None else self._people.get(session.name)
        if session is None or entry is None or session.until <= self._clock() or session.entry != entry_digest(entry):
            return None
        return entry

    def end(self, cookie: str | None) -> None:
        if self._sessions.pop(digest_of(cookie or ""), None) is not None:
            self._write()

    def _write(self) -> None:
        """Writes the file of sessions; the page works without it."""
        if self._file is None:
            return
        try:
            write_whole(self._file, msgspec.json.encode(self._sessions), sync=False)
        except OSError as error:
            log.warning("sessions cannot be written, a restart ends them: %s", error)


def sessions_file() -> Path | None:
    """Returns the file of sessions in systemd's RuntimeDirectory; None if there is no such directory."""
    folder = os.environ.get("RUNTIME_DIRECTORY")
    return None if folder is None else Path(folder) / "sessions.json"


def entry_digest(entry: PersonEntry) -> str:
    return digest_of(f"{entry.role} {entry.token}")
