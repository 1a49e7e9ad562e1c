"""The arm's file: interlocks, which are inputs or bits of objects."""

from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.drivers.canopen.wiring import Interlock, WatchedObject
from tests.arm_files import document
from tests.armfile.test_kinds_of_actuators import loaded


def with_interlock(**fields: Any) -> dict[str, Any]:
    """The valid document with an interlock on a board of its own."""
    return {**document(), "interlocks": {"door": {"bus": "can0", "node": 9, "input": 3, **fields}}}


def with_object(index: Any, **fields: Any) -> dict[str, Any]:
    """The same with a bit of an object as the interlock."""
    return with_interlock(**{"input": None, "object": index, "bit": 0, **fields})


# What is wrong with an interlock, and the beginning of the one fault that says so.
FAULTS = [
    (with_interlock(bus="can7"), "interlocks.door.bus: 'can7' is none of the buses can0, spare"),
    (with_interlock(node=127), "interlocks.door.node: Expected `int` <= 126 (given: 127)"),
    (with_interlock(node=1, input=0), "interlocks.door.input: input 0 of can0/1 is 1.left's already"),
    (with_interlock(output=0), "interlocks.door.output: unknown field; known are bit, bus, input, inverted"),
    (with_interlock(input=None), "interlocks.door: neither input nor object; needed is, for example, input: 3"),
    (with_interlock(bit=3), "interlocks.door.bit: without `object`; needed is, for example, object: 0x2102"),
    (with_interlock(sub=1), "interlocks.door.sub: without `object`"),
    (with_interlock(object=0x2102, bit=0), "interlocks.door.input: 3, but 0x2102 is given, too; an interlock is an i"),
    (with_object(0x2102, bit=None), "interlocks.door.bit: required with `object`, from 0 to 31"),
    (with_object(0x2102, bit=32), "interlocks.door.bit: Expected `int` <= 31 (given: 32)"),
    (with_object(0x2102, sub=255), "interlocks.door.sub: Expected `int` <= 254 (given: 255)"),
    (with_object("2102h"), "interlocks.door.object: Expected `int | null`, got `str` (given: '2102h')"),
    (
        with_object(2102),
        "interlocks.door.object: 0x0836, but 0x1001, 0x1002 or an object from 0x2000 to 0x9fff is needed; did you m",
    ),
    (with_object(0x1000), "interlocks.door.object: 0x1000, but 0x1001, 0x1002 or an object from 0x2000 to 0x9fff is"),
    (
        with_object(0x6000, sub=2, bit=3),
        "interlocks.door.object: 0x6000 has the inputs of the board; needed is input: 11",
    ),
    (with_object(0x1001, bit=8, inverted=True), "interlocks.door.bit: 1001h has sub 0 only, with 8 bits in 1001h"),
    (with_object(0x1001), "interlocks.door.inverted: false, but the bits of 1001h (error register) are 1 in an erro"),
    (
        {
            **with_object(0x2102),
            "interlocks": {name: {"bus": "can0", "node": 9, "object": 0x2102, "bit": 0} for name in "ab"},
        },
        "interlocks.b.bit: 2102h sub 0 bit 0 of can0/9 is interlock a's already",
    ),
    ({**document(), "interlocks": {"the door": {"bus": "can0", "node": 9, "input": 3}}}, "interlocks.the door: Expect"),
    ({**document(), "interlocks": [1]}, "interlocks: Expected `object`, got `array` (given: [1])"),
]


@pytest.mark.parametrize(("value", "beginning"), FAULTS, ids=[fault[:40] for _, fault in FAULTS])
def test_each_fault_names_field_value_and_need(tmp_path: Path, value: dict[str, Any], beginning: str) -> None:
    with pytest.raises(InputFaults) as caught:
        loaded(tmp_path, value)
    (fault,) = caught.value.faults
    assert fault.startswith(beginning)


def test_an_interlock_may_be_a_bit_of_an_object(tmp_path: Path) -> None:
    watched = Interlock("door", "can0", 9, 4, watched=WatchedObject(0x2102, 1))
    assert loaded(tmp_path, with_object(0x2102, sub=1, bit=4)).wiring.interlocks == (watched,)
