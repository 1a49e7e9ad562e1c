"""Hints in faults: the nearest name, the choices, and numbers with units."""

from typing import Annotated, Literal

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, Struct, field

from hyperbit.controller.armfile.choices import hint_of, number_hint, plain, unknown_field
from hyperbit.controller.armfile.strict import check

Time = Annotated[float, Meta(gt=0, le=60, description="in seconds")]
Name = Annotated[str, Meta(pattern="^[a-z]{1,8}$", description="1 to 8 small letters")]


class Settings(Struct, forbid_unknown_fields=True):
    loss: Literal["hold", "contract"] = "hold"
    state: Literal["off", "hold"] | bool | None = None
    time: Time | None = None
    count: int = 1
    note: str = ""
    name: Name | None = None
    gates: dict[Name, int] = field(default_factory=dict)


def faults_of(text: str) -> list[str]:
    faults: list[str] = []
    check(yaml.safe_load(text), Settings, faults)
    return faults


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("loss: holt", "loss: 'holt' is unknown; did you mean 'hold'? It must be one of hold, contract"),
        ("loss: elsewhere", "loss: 'elsewhere' is unknown; it must be one of hold, contract"),
        ("loss: off", "loss: false, but it must be one of hold, contract; YAML reads off, no and false without quotes"),
        ("loss: on", "loss: true, but it must be one of hold, contract; YAML reads on, yes and true without quotes"),
        ("loss: 5", "loss: Expected `str`, got `int` (given: 5)"),
        ("state: of", "state: 'of' is unknown; did you mean 'off'? It must be one of off, hold"),
        ("time: 100ms", "time: Expected `float | null`, got `str` (given: '100ms'); write 0.1 (seconds)"),
        ("time: 0.5 min", "time: Expected `float | null`, got `str` (given: '0.5 min'); write 30 (seconds)"),
        ("time: 90deg", "time: Expected `float | null`, got `str` (given: '90deg'); this number is in seconds"),
        ("time: 20 mm", "time: Expected `float | null`, got `str` (given: '20 mm'); this number is in seconds"),
        ("count: 20 mm", "count: Expected `int`, got `str` (given: '20 mm'); write a number without a unit: all"),
        ("time: 3 V", "time: Expected `float | null`, got `str` (given: '3 V'); write a number without a unit"),
        ("time: 1e-3", "time: Expected `float | null`, got `str` (given: '1e-3'); YAML reads it as text: write 0.001"),
        ("count: 500 kbit/s", "count: Expected `int`, got `str` (given: '500 kbit/s'); write 500000 (bit/s)"),
        ("time: 200", "time: Expected `float` <= 60.0 (given: 200); in seconds"),
        ("time: soon", "time: Expected `float | null`, got `str` (given: 'soon'); in seconds"),
        ("note: 1", 'note: Expected `str`, got `int` (given: 1); write it in quotes'),
        ("note: 1.5", 'note: Expected `str`, got `float` (given: 1.5); write it in quotes'),
        ("note: on", "note: Expected `str`, got `bool` (given: True); write it in quotes"),
        ("name: a b", "name: Expected `str` of 1 to 8 small letters (given: 'a b')"),
        ("gates: {a b: 1}", "gates.a b: Expected `str` of 1 to 8 small letters (given: 'a b')"),
        ("gates: [1]", "gates: Expected `object`, got `array` (given: [1]); a list has no names: write NAME"),
        ("tiem: 1", "tiem: unknown field; did you mean 'time'? Known are count, gates, loss, name, note, state, time"),
        ("zzzzz: 1", "zzzzz: unknown field; known are count, gates, loss, name, note, state, time"),
    ],
)  # fmt: skip
def test_a_fault_says_what_would_be_right(text, expected):
    (fault,) = faults_of(text)
    assert fault.startswith(expected)


def test_a_plain_off_is_a_value_where_the_field_has_it():
    assert faults_of("state: off") == []


@given(st.floats(1e-12, 1e12))
def test_a_number_that_is_proposed_is_a_number_in_yaml(number):
    assert float(yaml.safe_load(plain(number))) == pytest.approx(number, rel=1e-8)
    assert not isinstance(yaml.safe_load(plain(number)), str)


@given(st.text(max_size=30) | st.text("0123456789.eE+- msµ°/", max_size=12))
def test_any_text_has_a_hint_or_none(text):
    assert isinstance(hint_of(text, float), str)
    assert unknown_field(text, {"a", "b"})


@pytest.mark.parametrize(
    ("text", "hint"),
    [("0,3", "; write a decimal point: 0.3"), ("1,000", "; write 1.000, or 1000 if the comma separates thousands")],
)
def test_a_comma_in_a_number_is_explained(text: str, hint: str) -> None:
    assert number_hint(text) == hint
