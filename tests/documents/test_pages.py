"""Pages are short, their links and commands exist, and their tables agree with the code."""

from __future__ import annotations

import importlib.util
import re
from collections import defaultdict
from typing import get_type_hints

import msgspec
import pytest
import yaml

import hyperbit
from tests.documents import facts, page, reference, running

PAGES = page.find()
FRONT = page.ROOT / "README.md"
LENGTH, WORDS, FRONT_LENGTH = 250, 1300, 150  # lines of a page; words and lines of README.md
OPTIONAL = {f"fields of {name}" for name in facts.STRUCTS} - {"fields of ArmSettings", "fields of GoalMessage"}
named = pytest.mark.parametrize("path", PAGES, ids=lambda path: page.read(path).name)


@named
def test_the_page_is_short(path):
    text = path.read_text()
    assert len(text.splitlines()) <= (FRONT_LENGTH if path == FRONT else LENGTH)
    assert path != FRONT or len(text.split()) <= WORDS


@named
def test_each_link_leads_to_a_file(path):
    read = page.read(path)
    for target in page.links(read):
        file, _, heading = target.partition("#")
        found = path.parent / file if file else path
        assert found.exists(), f"{read.name}: {target}"
        if heading:
            assert heading in page.headings(page.read(found)), f"{read.name}: {target} has no such heading"


@named
def test_each_path_in_backticks_exists(path):
    read = page.read(path)
    missing = [text for text in page.paths(read) if not list(page.ROOT.glob(text.rstrip("/")))]
    assert not missing, f"{read.name}: {missing}"


@named
def test_each_command_and_option_exists(path):
    read = page.read(path)
    for call in page.commands(read):
        command, *words = call.split()
        if command.startswith("-"):
            continue  # an option of `hyperbit` itself
        assert command in facts.cli.COMMANDS, f"{read.name}: hyperbit {call}"
        known = running.options(command)
        unknown = [word for word in words if word.startswith("--") and word.partition("=")[0] not in known]
        assert not unknown, f"{read.name}: hyperbit {call}: no option {unknown}"


@named
def test_each_module_that_is_run_exists(path):
    read = page.read(path)
    missing = [name for name in page.modules(read) if importlib.util.find_spec(name) is None]
    assert not missing, f"{read.name}: {missing}"


@named
def test_each_target_of_make_exists(path):
    read = page.read(path)
    missing = set(page.targets(read)) - facts.targets()
    assert not missing, f"{read.name}: {missing}"


def tables() -> dict[str, list[tuple[str, page.Table]]]:
    found = defaultdict[str, list[tuple[str, page.Table]]](list)
    for read in map(page.read, PAGES):
        for table in read.tables:
            found[table.name].append((read.name, table))
    return found


@named
def test_each_table_is_known(path):
    assert {table.name for table in page.read(path).tables} <= facts.TABLES.keys()


@pytest.mark.parametrize("name", facts.TABLES)
def test_the_table_is_that_of_the_code(name):
    found = tables()[name]
    names = [row for _, table in found for row in table.names]
    places = {where for where, _ in found}
    assert len(places) == 1 or (not places and name in OPTIONAL), f"{name}: on {places or 'no page'}"
    if places:
        assert sorted(names) == sorted(facts.TABLES[name]()), f"{places}: the table of {name} differs from the code"


@named
def test_each_example_of_a_field_suits_its_type(path):
    read = page.read(path)
    for table in read.tables:
        if table.name.removeprefix("fields of ") not in facts.STRUCTS:
            continue
        for text in table.examples:
            ((name, value),) = yaml.safe_load(text).items()
            struct = facts.STRUCTS[table.name.removeprefix("fields of ")]
            assert name in table.names
            msgspec.convert(value, get_type_hints(struct, include_extras=True)[name])


def test_each_fault_that_the_code_makes_is_known():
    assert facts.faults_of_the_code() <= facts.faults()


def test_each_row_of_the_reasons_of_refusals_is_that_of_the_code():
    lines = (page.ROOT / "controller" / "refusals" / "README.md").read_text().splitlines()
    assert [line for line in lines if line.startswith("| `")] == facts.reasons()


def test_the_front_page_names_each_page():
    front = page.read(FRONT)
    linked = {(FRONT.parent / target).resolve() for target in page.links(front)}
    assert set(PAGES) - {FRONT} <= linked


def test_the_reference_of_the_library_is_that_of_its_docstrings():
    assert reference.PATH.read_text() == reference.text(), "python -m tests.documents.reference"


def test_each_name_of_the_library_is_on_its_pages():
    text = reference.PATH.read_text() + reference.PATH.with_name("README.md").read_text()
    missing = [name for name in hyperbit.__all__ if not re.search(rf"(`|## |hb\.){name}\b", text)]
    assert not missing
