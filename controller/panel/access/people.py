"""People who may open the page: their roles and tokens, and the file that lists them."""

import hashlib
import secrets
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta, Struct

from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.strict import InputFaults, check

Role = Literal["viewer", "operator"]

TOKEN_BYTES = 32


class Person(NamedTuple):
    name: str
    role: Role
    stop: bool = False  # whether a viewer may stop arms

    @property
    def may_stop(self) -> bool:
        return self.stop or self.role == "operator"


class PersonEntry(Struct, forbid_unknown_fields=True, frozen=True):
    # a client certificate with this common name needs no token
    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,32}\Z", description="1 to 32 letters, digits, _ and -")]
    role: Role
    # SHA-256 of the person's token, hexadecimal; None: the person needs a client certificate
    token: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")] | None = None
    stop: bool = False  # whether a viewer may stop arms


class People(Struct, forbid_unknown_fields=True, frozen=True):
    people: Annotated[list[PersonEntry], Meta(min_length=1, max_length=1000)]


def digest_of(token: str) -> str:
    """Returns the SHA-256 of a token or cookie, in hexadecimal."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


def new_token() -> str:
    return secrets.token_urlsafe(TOKEN_BYTES)


def read_people(path: Path) -> list[PersonEntry]:
    """Reads the people of a file. Raises InputFaults if the file is missing or wrong; each fault names its field."""
    faults = list[str]()
    found = check(read_yaml(path), People, faults)
    names = [entry.name for entry in found.people] if found else []
    faults += [f"people: {name} is listed twice" for name in sorted({n for n in names if names.count(n) > 1})]
    if faults or found is None:
        raise InputFaults(path, faults)
    return found.people
