"""Access to the page: people with a role, their tokens, and signed cookies."""

import hashlib
import hmac
import os
import secrets
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, Struct

from controller.armfile.strict import InputFaults, check, read_yaml

Role = Literal["viewer", "operator"]

LASTS = 12 * 3600.0  # [s] lifetime of a cookie
MOST_WRONG, WRONG_WITHIN = 10, 60.0  # after this number of wrong tokens within these seconds, no token is checked
TOKEN_BYTES = 32


class Person(NamedTuple):
    """A person who may open the page, with a role."""

    name: str
    role: Role


class PersonEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """One entry of the file of people.

    Attributes:
        name: of the person; a client certificate with this common name needs no token.
        role: "viewer" or "operator".
        token: SHA-256 of the person's token, hexadecimal; None: the person needs a client certificate.
    """

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,32}\Z")]
    role: Role
    token: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")] | None = None


class People(Struct, forbid_unknown_fields=True, frozen=True):
    """The file of people."""

    people: Annotated[list[PersonEntry], Meta(min_length=1, max_length=1000)]


class TooManyWrong(Exception):
    """Too many wrong tokens were sent; no token is checked for a while."""


class Access:
    """Checks tokens and cookies. Not thread-safe.

    Args:
        people: people who may open the page, with distinct names.
        key: key that signs cookies.
        clock: returns UNIX time [s].
    """

    def __init__(self, people: Sequence[PersonEntry], key: bytes, clock: Callable[[], float] = time.time) -> None:
        self._people = {entry.name: entry for entry in people}
        self._key, self._clock = key, clock
        self._wrong: list[float] = []

    def enter(self, token: str) -> str | None:
        """Returns a new cookie for a token; None if the token is wrong.

        Raises:
            TooManyWrong: too many wrong tokens were sent.
        """
        if (found := self._holder(token)) is None:
            return None
        content = f"{found.name}.{int(self._clock() + LASTS)}"
        return f"{content}.{self._signature(content, found)}"

    def bearer(self, token: str) -> Person | None:
        """Returns the person of a token; None if the token is wrong.

        Raises:
            TooManyWrong: too many wrong tokens were sent.
        """
        found = self._holder(token)
        return None if found is None else Person(found.name, found.role)

    def _holder(self, token: str) -> PersonEntry | None:
        """Returns the entry of a token; counts wrong tokens."""
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
        """Returns the person of a cookie; None if the cookie is invalid or too old."""
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
        """Returns the person with the common name of a client certificate; None if there is none."""
        entry = self._people.get(name or "")
        return None if entry is None else Person(entry.name, entry.role)

    def _signature(self, content: str, entry: PersonEntry) -> str:
        """Returns the signature of a cookie; a change of token or role invalidates older cookies."""
        words = f"{content}.{entry.role}.{entry.token}".encode()
        return hmac.new(self._key, words, hashlib.sha256).hexdigest()


def digest_of(token: str) -> str:
    """Returns the SHA-256 of a token, in hexadecimal."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def new_token() -> str:
    """Returns a random token of 32 bytes, as text."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def read_people(path: Path) -> list[PersonEntry]:
    """Reads the people of a file.

    Raises:
        InputFaults: the file is missing or wrong; each fault names its field.
    """
    faults = list[str]()
    found = check(read_yaml(path), People, faults)
    names = [entry.name for entry in found.people] if found else []
    faults += [f"people: {name} is listed twice" for name in sorted({n for n in names if names.count(n) > 1})]
    if faults or found is None:
        raise InputFaults(path, faults)
    return found.people


def cookie_key() -> bytes:
    """Returns the key that signs cookies: from systemd's StateDirectory if there is one, else new at each start."""
    if (folder := os.environ.get("STATE_DIRECTORY")) is None:
        return secrets.token_bytes(32)
    path = Path(folder) / "cookie-key"
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if len(key := path.read_bytes()) == 32:
            return key
        path.unlink()  # incomplete: the computer stopped during the write
        return cookie_key()
    with os.fdopen(descriptor, "wb") as file:
        file.write(key := secrets.token_bytes(32))
    return key
