"""Who may look and who may command: people, their tokens, and the cookies that they get for them."""

import hashlib
import hmac
import os
import secrets
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, Struct

from controller.strict import InputFaults, check, read_yaml

Role = Literal["viewer", "operator"]

LASTS = 12 * 3600.0  # [s] of a cookie
MOST_WRONG, WRONG_WITHIN = 10, 60.0  # wrong tokens from anywhere in so many seconds; then none is looked at for a while
TOKEN_BYTES = 32


class Person(NamedTuple):
    """Somebody who may open the page."""

    name: str
    role: Role


class Listed(Struct, forbid_unknown_fields=True, frozen=True):
    """One entry of the file of people; `token` is the SHA-256 of a token, in hexadecimal.

    Without a token the person shows a client certificate with this name.
    """

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,32}\Z")]
    role: Role
    token: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")] | None = None


class People(Struct, forbid_unknown_fields=True, frozen=True):
    """The file of people."""

    people: Annotated[list[Listed], Meta(min_length=1, max_length=1000)]


class TooManyWrong(Exception):
    """Too many wrong tokens came; none is looked at for a while."""


class Access:
    """Checks tokens and cookies. One thread's.

    Args:
        people: who may open the page; names differ.
        key: with which cookies are signed.
        clock: UNIX time [s].
    """

    def __init__(self, people: Sequence[Listed], key: bytes, clock: Callable[[], float] = time.time) -> None:
        self._people = {entry.name: entry for entry in people}
        self._key, self._clock = key, clock
        self._wrong: list[float] = []

    def enter(self, token: str) -> str | None:
        """Returns the cookie for a token; None if it is nobody's.

        Raises:
            TooManyWrong: too many wrong tokens came.
        """
        if (found := self._holder(token)) is None:
            return None
        content = f"{found.name}.{int(self._clock() + LASTS)}"
        return f"{content}.{self._signature(content, found)}"

    def bearer(self, token: str) -> Person | None:
        """Returns whose token it is; None if it is nobody's.

        Raises:
            TooManyWrong: too many wrong tokens came.
        """
        found = self._holder(token)
        return None if found is None else Person(found.name, found.role)

    def _holder(self, token: str) -> Listed | None:
        """Returns the entry of a token, and counts wrong ones."""
        now = self._clock()
        self._wrong = [at for at in self._wrong if now - at < WRONG_WITHIN]
        if len(self._wrong) >= MOST_WRONG:
            raise TooManyWrong
        digest, found = digest_of(token), None
        for entry in self._people.values():
            if entry.token is not None and hmac.compare_digest(entry.token, digest):
                found = entry
        if found is None:
            self._wrong.append(now)
        return found

    def person(self, cookie: str | None) -> Person | None:
        """Returns whose cookie it is; None if it is nobody's, or too old."""
        parts = (cookie or "").split(".")
        if len(parts) != 3 or not parts[1].isascii() or not parts[1].isdecimal() or len(parts[1]) > 12:
            return None
        entry = self._people.get(parts[0])
        if entry is None or not parts[2].isascii() or int(parts[1]) < self._clock():
            return None
        if not hmac.compare_digest(self._signature(f"{parts[0]}.{parts[1]}", entry), parts[2]):
            return None
        return Person(entry.name, entry.role)

    def certified(self, name: str | None) -> Person | None:
        """Returns who shows a client certificate with this common name; None if nobody does."""
        entry = self._people.get(name or "")
        return None if entry is None else Person(entry.name, entry.role)

    def _signature(self, content: str, entry: Listed) -> str:
        """Returns the signature of a cookie; a changed token or role makes older cookies worthless."""
        words = f"{content}.{entry.role}.{entry.token}".encode()
        return hmac.new(self._key, words, hashlib.sha256).hexdigest()


def digest_of(token: str) -> str:
    """Returns the SHA-256 of a token, in hexadecimal."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def new_token() -> str:
    """Returns a token that nobody guesses."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def read_people(path: Path) -> list[Listed]:
    """Returns the people of a file.

    Raises:
        InputFaults: it is missing or wrong, by field.
    """
    faults = list[str]()
    found = check(read_yaml(path), People, faults)
    names = [entry.name for entry in found.people] if found else []
    faults += [f"people: {name} stands twice" for name in sorted({n for n in names if names.count(n) > 1})]
    if faults or found is None:
        raise InputFaults(path, faults)
    return found.people


def cookie_key() -> bytes:
    """Returns the key of cookies: kept in systemd's StateDirectory if there is one, else new at each start."""
    if (folder := os.environ.get("STATE_DIRECTORY")) is None:
        return secrets.token_bytes(32)
    path = Path(folder) / "cookie-key"
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if len(key := path.read_bytes()) == 32:
            return key
        path.unlink()  # the computer stopped while it was written
        return cookie_key()
    with os.fdopen(descriptor, "wb") as file:
        file.write(key := secrets.token_bytes(32))
    return key
