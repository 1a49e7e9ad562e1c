"""Strict decoding: YAML with its traps, and values against structs."""

from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, Struct

from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.strict import MOST_FAULTS, InputFaults, check


def read(tmp_path: Path, content: str | bytes):
    path = tmp_path / "arm.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_yaml(path)


def refusal(tmp_path: Path, content: str | bytes) -> str:
    with pytest.raises(InputFaults) as caught:
        read(tmp_path, content)
    (fault,) = caught.value.faults
    return fault


def test_plain_yaml_is_read(tmp_path):
    assert read(tmp_path, "a: [1, 2.5, x, true, 0]\nb: {c: null, d: 0x1D, e: 0.5}") == {
        "a": [1, 2.5, "x", True, 0],
        "b": {"c": None, "d": 29, "e": 0.5},
    }
    assert read(tmp_path, b"\xef\xbb\xbfa: 1") == {"a": 1}, "a byte order mark is no text"


def test_a_missing_file(tmp_path):
    with pytest.raises(InputFaults, match=r"nowhere\.yaml: no such file"):
        read_yaml(tmp_path / "nowhere.yaml")


def test_a_folder(tmp_path):
    with pytest.raises(InputFaults, match=r"cannot be read: .*directory"):
        read_yaml(tmp_path)


def test_text_that_is_not_utf8(tmp_path):
    assert refusal(tmp_path, b"name: \xff\xfe").startswith("cannot be read: 'utf-8' codec can't decode")


@pytest.mark.parametrize("content", [b"", b"\n \n", bytes(4096)])
def test_an_empty_file_is_told(tmp_path, content):
    assert refusal(tmp_path, content).startswith("is empty, as a failure of the power can leave it")


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_another_encoding_is_told_with_the_right_one(tmp_path, encoding):
    assert refusal(tmp_path, "name: \xe4".encode(encoding)).endswith("save it as UTF-8")


BOMB = "a: &a [x, x]\nb: &b [*a, *a, *a, *a]\nc: &c [*b, *b, *b, *b]\nd: [*c, *c, *c, *c]\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a: [1, 2", "is not YAML: while parsing a flow sequence"),
        ("a: b: c", "is not YAML: mapping values are not allowed here"),
        ("a: 'x", "is not YAML: while scanning a quoted scalar"),
        ("a: \0", "is not YAML: unacceptable character"),
        ("a: 1\n---\nb: 2", "is not YAML: expected a single document"),
        ("a: 1\nb: 2\na: 3", "is not YAML: 'a' occurs twice in"),
        ("x: {a: 1, a: 1}", "is not YAML: 'a' occurs twice in"),
        ("? [a]\n: 1", "is not YAML: while constructing a mapping"),
        ("a: !!python/name:os.system x", "is not YAML: could not determine a constructor"),
        ("a: !!bool maybe", "is not YAML: a value does not suit its !!tag"),
        ("a: !!int ''", "is not YAML: a value does not suit its !!tag"),
        ("a: !!timestamp x", "is not YAML: a value does not suit its !!tag"),
        ("a: 2020-13-45", "is not YAML: month must be in 1..12"),
        ("a: " + "9" * 5000, "is not YAML: Exceeds the limit"),
        ("a: 010", "is not YAML: 010 is 8 in YAML: write the number without 0 before it, : and _"),
        ("a: -1:30", "is not YAML: -1:30 is -90 in YAML: write the number"),
        ("a: 1_2", "is not YAML: 1_2 is 12 in YAML: write the number"),
        ("a: 1:30.5", "is not YAML: 1:30.5 is 90.5 in YAML: write the number"),
        ("a: 1_0.5", "is not YAML: 1_0.5 is 10.5 in YAML: write the number"),
        ("a: 0x_1", "is not YAML: 0x_1 is 1 in YAML: write the number"),
        ("[" * 1500, "its values are nested hundreds of levels deep"),
        ("\n".join(" " * k + "a:" for k in range(1500)), "its values are nested hundreds of levels deep"),
        ("a: 0x_" + "f" * 400, "is not YAML: int too large to convert to float"),
        ("a: !!set [1]", "is not YAML: a value does not suit its !!tag"),
        ("a: " + "x" * 4_000_000, "cannot be read: it has more than 4 MB, the most for such a file"),
        (BOMB, "is not YAML: alias *a: write its value out instead in"),
        ("a: &a [*a]", "is not YAML: alias *a: write its value out instead in"),
        ("a: &a {b: 1}\nc: {<<: *a}", "is not YAML: alias *a: write its value out instead in"),
    ],
    ids=lambda text: text[:24],
)
def test_what_is_refused(tmp_path, content, message):
    fault = refusal(tmp_path, content)
    assert fault.startswith(message)
    assert "\n" not in fault


@given(st.text("ab:-[]{}&*!|>'\"#,? \n1.~%@`", max_size=40))
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    try:
        read(tmp_path_factory.getbasetemp(), text)
    except InputFaults as error:
        refused = error.faults
    else:
        refused = ("read",)
    assert all(refused)


class Inner(Struct, forbid_unknown_fields=True):
    size: Annotated[float, Meta(gt=0)]
    count: int = 1


class Dog(Struct, tag_field="kind", tag="dog", forbid_unknown_fields=True):
    bark: str


class Cat(Struct, tag_field="kind", tag="cat", forbid_unknown_fields=True):
    lives: Annotated[int, Meta(le=9)] = 9


class Outer(Struct, forbid_unknown_fields=True):
    inner: Inner
    pets: Annotated[list[Dog | Cat], Meta(max_length=200)] = []
    angle: float | list[float] = 0.0
    note: str | None = None


def faults_of(value) -> list[str]:
    faults: list[str] = []
    assert (check(value, Outer, faults) is None) == bool(faults)
    return faults


def test_a_right_value_becomes_the_struct():
    faults: list[str] = []
    value = {"inner": {"size": 2}, "pets": [{"kind": "cat"}, {"kind": "dog", "bark": "x"}], "angle": [1, 2]}
    assert check(value, Outer, faults) == Outer(Inner(2.0), [Cat(), Dog("x")], [1.0, 2.0])
    assert not faults


@pytest.mark.parametrize(
    ("value", "fault"),
    [
        (None, "file: Expected `object`, got `null` (given: None)"),
        ([1], "file: Expected `object`, got `array` (given: [1])"),
        ({}, "inner: required, but missing"),
        ({"inner": {}}, "inner.size: required, but missing"),
        ({"inner": {"size": 1, "sise": 1}}, "inner.sise: unknown field; did you mean 'size'? Known are count, size"),
        ({"inner": {"size": 1}, 7: 1}, "7: unknown field; known are angle, inner, note, pets"),
        ({"inner": {"size": 0}}, "inner.size: Expected `float` > 0.0 (given: 0)"),
        (
            {"inner": {"size": "1"}},
            "inner.size: Expected `float`, got `str` (given: '1'); YAML reads it as text: write 1",
        ),
        ({"inner": {"size": True}}, "inner.size: Expected `float`, got `bool` (given: True)"),
        ({"inner": {"size": float("nan")}}, "inner.size: nan is not a finite number"),
        ({"inner": {"size": float("inf")}}, "inner.size: inf is not a finite number"),
        ({"inner": {"size": 1, "count": 1.5}}, "inner.count: Expected `int`, got `float` (given: 1.5)"),
        ({"inner": {"size": 1}, "angle": [1, float("-inf")]}, "angle[1]: -inf is not a finite number"),
        ({"inner": {"size": 1}, "note": 5}, "note: Expected `str | null`, got `int` (given: 5); write it in quotes"),
        ({"inner": {"size": 1}, "pets": [{}]}, "pets[0].kind: required, but missing; it must be one of dog, cat"),
        (
            {"inner": {"size": 1}, "pets": [{"kind": "cow"}]},
            "pets[0].kind: 'cow' is unknown; it must be one of dog, cat",
        ),
        (
            {"inner": {"size": 1}, "pets": [{"kind": "cat"}, {"kind": "cat", "lives": 10}]},
            "pets[1].lives: Expected `int` <= 9 (given: 10)",
        ),
        (
            {"inner": {"size": 1}, "pets": [{"kind": "dog", "bark": "x", "lives": 1}]},
            "pets[0].lives: unknown field; known are bark, kind",
        ),
        (
            {"inner": {"size": 1}, "note": ["x" * 100]},
            f"note: Expected `str | null`, got `array` (given: ['{'x' * 55}...)",
        ),
        ({"inner": {"size": "\ud800"}}, "inner.size: a lone surrogate is no text (given: '\\ud800')"),
        (
            {"inner": {"size": 1}, "note": 1 << 20_000},
            "note: Expected `str | null`, got `int` (given: a number of thousands of digits); write it in quotes",
        ),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, str) else "",
)
def test_a_fault_is_named_by_its_path(value, fault):
    assert faults_of(value) == [fault]


def test_every_fault_is_told_at_once():
    value = {"inner": {"size": -1, "count": "x"}, "pets": [{"kind": "dog"}], "angel": 1}
    assert [fault.split(":")[0] for fault in faults_of(value)] == ["angel", "inner.size", "inner.count", "pets[0].bark"]


def test_lists_of_faults_end():
    assert len(faults_of({"inner": {"size": 1}, "pets": [{"kind": "dog"}] * 150})) == MOST_FAULTS


def test_faults_are_made_printable():
    error = InputFaults(Path("arm.yaml"), ["\ud800: unknown field"])
    assert str(error) == "arm.yaml: \\ud800: unknown field"


def test_the_message_has_a_line_for_each_fault():
    error = InputFaults(Path("arm.yaml"), ["a: wrong", "b: missing"])
    assert str(error) == "arm.yaml: a: wrong\narm.yaml: b: missing"
