"""Text forms of configurations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration


def arm_of(*states: int) -> Manipulator:
    return Manipulator([transforms([frames.planar(k, 1) for k in range(n)], planar=True) for n in states])


@given(st.lists(st.integers(2, 14), min_size=1, max_size=6), st.data())
def test_what_is_written_reads_back(states, data):
    manipulator = arm_of(*states)
    configuration = [data.draw(st.integers(0, n - 1)) for n in states]
    text = format_configuration(manipulator, np.array(configuration))
    assert ("," in text) == (max(states) > 10 and len(states) > 1)
    assert parse_configuration(manipulator, text).tolist() == configuration


@given(st.text("0123456789,-+. x", max_size=7))
def test_any_text_is_read_or_refused_by_name(text):
    manipulator = arm_of(8, 8, 2)
    try:
        configuration = parse_configuration(manipulator, text)
    except ValueError as error:
        message = str(error)
    else:
        written = format_configuration(manipulator, configuration)
        message = f"configuration {text!r}"
        assert parse_configuration(manipulator, written).tolist() == configuration.tolist()
    assert message.startswith(f"configuration {text!r}")


def test_digits_go_from_base_to_tip():
    assert parse_configuration(arm_of(8, 8, 2), " 071\n").tolist() == [0, 7, 1]
    assert parse_configuration(arm_of(8, 8, 2), "0,7,1").tolist() == [0, 7, 1]
    assert parse_configuration(arm_of(12, 2), "11,1").tolist() == [11, 1]
    assert parse_configuration(arm_of(12), "11").tolist() == [11]


@pytest.mark.parametrize(
    ("states", "text", "message"),
    [
        ((8, 8), "0x", "configuration '0x': every module state must be a whole number"),
        ((8, 8), "0 1", "configuration '0 1': every module state must be a whole number"),
        ((8, 8), "1.5,2", "configuration '1.5,2': every module state must be a whole number"),
        ((12, 8), "", "configuration '': every module state must be a whole number"),
        ((8, 8), "", "configuration '' has 0 modules, the arm has 2"),
        ((8, 8), "012", "configuration '012' has 3 modules, the arm has 2"),
        ((12, 8), "01", "configuration '01' has 1 modules, the arm has 2"),
        ((8, 2), "12", "configuration '12': module 2 has states 0 to 1, not 2"),
        ((12, 2), "12,0", "configuration '12,0': module 1 has states 0 to 11, not 12"),
        ((12, 2), "-1,0", "configuration '-1,0': module 1 has states 0 to 11, not -1"),
    ],
)
def test_faults_are_named(states, text, message):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the message is compared in full
        parse_configuration(arm_of(*states), text)
    assert str(caught.value) == message
