"""Limits of open pages, so that nobody takes the places of others."""

import pytest

from hyperbit.controller.panel.access import places
from hyperbit.controller.panel.access.people import Person
from hyperbit.controller.panel.access.places import (
    MOST_OF_ADDRESS,
    MOST_OF_PERSON,
    MOST_PAGES,
    MOST_VIEWERS,
    PagePlace,
    Places,
)
from tests.panel.conftest import OPERATOR, OTHER, VIEWER, Site


def filled(people: list[tuple[str, str]], role: places.Role) -> Places:
    filling = Places()
    for name, address in people:
        if filling.refusal(place := PagePlace(Person(name, role), address)) is None:
            filling.take_place(place)
    return filling


def test_viewers_leave_places_for_operators() -> None:
    taken = filled([(f"v{k}", f"a{k}") for k in range(MOST_PAGES)], "viewer")
    assert taken.taken == MOST_VIEWERS
    assert "too many pages" in str(taken.refusal(PagePlace(Person("another", "viewer"), "another")))
    assert taken.refusal(PagePlace(Person("anna", "operator"), "a0")) is None


def test_a_person_and_an_address_have_limits() -> None:
    person = filled([("hall", f"a{k}") for k in range(MOST_PAGES)], "viewer")
    assert person.taken == MOST_OF_PERSON
    assert "hall has too many" in str(person.refusal(PagePlace(Person("hall", "viewer"), "another")))
    address = filled([(f"v{k}", "a") for k in range(MOST_PAGES)], "viewer")
    assert address.taken == MOST_OF_ADDRESS
    assert "at this address" in str(address.refusal(PagePlace(Person("another", "viewer"), "a")))
    assert address.refusal(PagePlace(Person("anna", "operator"), "a")) is None


def test_a_closed_page_frees_its_place() -> None:
    place = PagePlace(Person("hall", "viewer"), "a")
    taken = filled([("hall", "a")] * MOST_PAGES, "viewer")
    taken.free_place(place)
    assert taken.refusal(place) is None


def test_an_operator_opens_a_page_while_viewers_hold_all_of_theirs(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "MOST_VIEWERS", 3)
    monkeypatch.setattr(places, "MOST_OF_PERSON", 4)
    viewers = [site.open(VIEWER, "/live") for _ in range(4)]
    assert viewers.pop().closed() == 4429
    operators = [site.open(OPERATOR) for _ in range(5)]
    assert operators.pop().closed() == 4429
    for page in (*operators, site.open(OTHER)):
        assert page.until("you")["role"] == "operator"
