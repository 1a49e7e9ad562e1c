"""The lock of versions: robots install what the tests ran with."""

from importlib.metadata import version

import pytest

from tests.deploy import versions


@pytest.fixture(scope="module")
def pinned() -> dict[str, str]:
    lines = [line for line in versions.PATH.read_text().splitlines() if not line.startswith("#")]
    return dict(line.partition("  #")[0].split("==") for line in lines)


def test_the_lock_is_what_these_tests_run_with(pinned: dict[str, str]) -> None:
    assert {name: version(name) for name in pinned} == pinned, "make lock, or make test in a new .venv"


def test_the_lock_has_all_that_the_parts_need() -> None:
    assert versions.PATH.read_text() == versions.text(), "make lock"


def test_pictures_are_no_dependency_of_others(pinned: dict[str, str]) -> None:
    assert {"matplotlib", "pillow"} <= pinned.keys()
    assert not {"matplotlib", "pillow"} & versions.closure("")
