"""Limits of open pages: for all viewers, for each person, and for each address. Some places are for operators only."""

from collections import Counter
from typing import NamedTuple

from hyperbit.controller.panel.access.people import Person, Role

MOST_PAGES, MOST_VIEWERS = 100, 60  # open pages of all people, and of viewers; the rest is for operators
MOST_OF_PERSON = 30
MOST_OF_ADDRESS = 50  # of each role: a viewer at an operator's address must not take the operator's places


class PagePlace(NamedTuple):
    person: Person
    address: str


class Places:
    """The places of open pages. Used only on the event loop of the pages."""

    def __init__(self) -> None:
        self._roles = Counter[Role]()
        self._people = Counter[str]()
        self._addresses = Counter[tuple[Role, str]]()

    @property
    def taken(self) -> int:
        return self._roles.total()

    def refusal(self, place: PagePlace) -> str | None:
        person, address = place
        if self.taken >= MOST_PAGES or (person.role == "viewer" and self._roles["viewer"] >= MOST_VIEWERS):
            return "too many pages are open"
        if self._people[person.name] >= MOST_OF_PERSON:
            return f"{person.name} has too many open pages: close some"
        if self._addresses[person.role, address] >= MOST_OF_ADDRESS:
            return "too many pages are open at this address: close some"
        return None

    def take_place(self, place: PagePlace) -> None:
        self._count(place, 1)

    def free_place(self, place: PagePlace) -> None:
        self._count(place, -1)

    def _count(self, place: PagePlace, change: int) -> None:
        person, address = place
        self._roles[person.role] += change
        self._people[person.name] += change
        self._addresses[person.role, address] += change
        if not self._addresses[person.role, address]:
            del self._addresses[person.role, address]
