"""Access to the page: people, tokens, sessions, delays of wrong tokens."""

import re
import time
from pathlib import Path

import pytest

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.decoding.decoding import decode
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.access.people import Person, PersonEntry, digest_of, read_people
from hyperbit.controller.panel.access.sessions import LASTS, MOST_OF_PERSON, Session, sessions_file
from hyperbit.controller.panel.access.wrong_tokens import FIRST_DELAY, FREE, LONGEST_DELAY, WrongTokens
from tests.clock import Clock

ANNA = PersonEntry("anna", "operator", digest_of("a"))


def test_sessions_end(tmp_path: Path) -> None:
    clock, file = Clock(), tmp_path / "sessions.json"
    access = Access([ANNA], file, clock)
    first, second = access.enter("a"), access.enter("a")
    assert first is not None
    assert first != second
    assert access.person(first) == access.person(second) == Person("anna", "operator")
    for forged in (None, "", "anna", first + "x", first[:-1], "\ud800"):
        assert access.person(forged) is None
    assert first not in file.read_text()
    access.leave(first)
    restarted = Access([ANNA], file, clock)
    assert restarted.person(first) is None, "logged out, also after a restart"
    assert restarted.person(second) is not None
    assert Access([PersonEntry("anna", "viewer", ANNA.token)], file, clock).person(second) is None, "another role"
    assert Access([PersonEntry("anna", "operator", digest_of("b"))], file, clock).person(second) is None
    assert Access([PersonEntry("bert", "operator", ANNA.token)], file, clock).person(second) is None
    clock.now += 13 * 3600
    assert restarted.person(second) is None
    file.write_text("{")
    assert Access([ANNA], file, clock).person(second) is None


def test_a_restart_of_the_computer_ends_the_sessions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise their file would need times of the system's clock, which may be set."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    assert sessions_file() is None
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    file = sessions_file()
    assert file is not None
    cookie = Access([ANNA], file).enter("a")
    (session,) = decode(file.read_bytes(), dict[str, Session]).values()
    assert 0.0 < session.until - time.monotonic() <= LASTS
    assert Access([ANNA], file).person(cookie) is not None


def test_a_person_has_few_sessions() -> None:
    access = Access([ANNA, PersonEntry("bert", "viewer", digest_of("b"))])
    other, cookies = access.enter("b"), [access.enter("a") for _ in range(MOST_OF_PERSON + 1)]
    assert [access.person(cookie) is None for cookie in cookies] == [True] + [False] * MOST_OF_PERSON
    assert access.person(other) is not None


def test_tokens_are_not_guessed() -> None:
    access = Access([ANNA, PersonEntry("carl", "operator")])
    assert [access.enter(token) for token in ("", "b", "aa", "None")] == [None] * 4
    assert access.bearer("a") == Person("anna", "operator")
    assert access.certified("carl") == Person("carl", "operator")
    assert access.certified(None) is None


def test_wrong_tokens_delay_the_answers_to_their_address() -> None:
    clock = Clock()
    wrong = WrongTokens(clock)
    delays = [wrong.delay("a") for _ in range(1000)]
    assert delays[:6] == [0.0] * FREE + [FIRST_DELAY, 2 * FIRST_DELAY, 4 * FIRST_DELAY]
    assert delays[-1] == LONGEST_DELAY
    assert wrong.delay("b") == 0.0
    clock.now += 61
    assert wrong.delay("a") == 0.0


def test_the_file_of_people_is_read_strictly(tmp_path: Path) -> None:
    path = tmp_path / "people.yaml"
    path.write_text(f"people: [{{name: anna, role: operator, token: {digest_of('a')}}}, {{name: carl, role: viewer}}]")
    assert read_people(path) == [ANNA, PersonEntry("carl", "viewer")]
    for text, fault in (
        ("people: []", "people"),
        ("people: [{name: anna, role: king}]", "people[0].role"),
        ("people: [{name: 'a.b', role: viewer}]", "people[0].name"),
        ("people: [{name: a, role: viewer, token: secret}]", "people[0].token"),
        ("people: [{name: a, role: viewer}, {name: a, role: operator}]", "a is listed twice"),
    ):
        path.write_text(text)
        with pytest.raises(InputFaults, match=re.escape(fault)):
            read_people(path)
