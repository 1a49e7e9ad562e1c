"""The contract between planner and executor: each message is decoded as it was encoded, everything else is refused."""

from typing import Any, get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller import program
from hyperbit.controller.program import (
    MOST_ACTUATORS,
    MOST_BYTES,
    MOST_STAGES,
    VERSION,
    Alive,
    Cancel,
    Counts,
    Hello,
    Malformed,
    Program,
    Replacement,
    Setpoint,
    Stage,
    decode_down,
    decode_up,
    encode,
    pack,
    unpack,
)

DOWN, UP = get_args(program.Down), get_args(program.Up)
numbers = st.integers(0, 2**62)


def of(info: msgspec.inspect.Type) -> st.SearchStrategy[Any]:
    match info:
        case msgspec.inspect.Metadata(type=inner):
            return of(inner)
        case msgspec.inspect.IntType(ge=least, le=most, lt=below):
            top = most if most is not None else (below - 1 if below is not None else 2**31)
            return st.integers(-(2**31) if least is None else least, top)
        case msgspec.inspect.FloatType(ge=least, le=most):
            return st.floats(least, most, allow_nan=False, allow_infinity=False)
        case msgspec.inspect.StrType(max_length=most):
            return st.text(max_size=min(most or 20, 20))
        case msgspec.inspect.BytesType(max_length=most):
            return st.binary(max_size=min(most or 40, 40))
        case msgspec.inspect.BoolType():
            return st.booleans()
        case msgspec.inspect.NoneType():
            return st.none()
        case msgspec.inspect.EnumType(cls=cls):
            return st.sampled_from(list(cls))
        case msgspec.inspect.LiteralType(values=choices):
            return st.sampled_from(choices)
        case msgspec.inspect.VarTupleType(item_type=item):
            return st.lists(of(item), max_size=3).map(tuple)
        case msgspec.inspect.ListType(item_type=item):
            return st.lists(of(item), max_size=3)
        case msgspec.inspect.DictType(key_type=key, value_type=value):
            return st.dictionaries(of(key), of(value), max_size=3)
        case msgspec.inspect.UnionType(types=types):
            return st.one_of([of(one) for one in types])
        case msgspec.inspect.StructType(cls=cls):
            return structs(cls)
    raise AssertionError(info)


def structs(kind: type) -> st.SearchStrategy[Any]:
    info = msgspec.inspect.type_info(kind)
    assert isinstance(info, msgspec.inspect.StructType)
    return st.builds(kind, **{field.name: of(field.type) for field in info.fields})


@pytest.mark.parametrize("kind", DOWN + UP, ids=lambda kind: kind.__name__)
def test_every_message_comes_through_and_goes_one_way_only(kind: type) -> None:
    there, back = (decode_down, decode_up) if kind in DOWN else (decode_up, decode_down)

    @given(structs(kind))
    def check(message: Any) -> None:
        data = encode(message)
        assert len(data) <= MOST_BYTES
        assert there(data) == message
        with pytest.raises(Malformed):
            back(data)

    check()


def refused(data: bytes) -> str:
    """Asserts that both directions refuse a packet, and returns why."""
    for decode in (decode_up, decode_down):
        with pytest.raises(Malformed) as caught:
            decode(data)
    return str(caught.value)


def taken_or_malformed(data: bytes) -> None:
    """Asserts that only Malformed is raised, with a reason, and that a decoded message is encoded to the same bytes."""
    for decode in (decode_down, decode_up):
        reason = ""
        try:
            packet = encode(decode(data))
        except Malformed as error:
            reason = str(error)
        else:
            assert encode(decode(packet)) == packet
            continue
        assert len(reason) > 10


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_else(data: bytes) -> None:
    taken_or_malformed(data)


messages = st.one_of([structs(kind) for kind in (*DOWN, *UP)])


@given(messages, st.data())
def test_a_truncated_message_is_refused(message: Any, data: st.DataObject) -> None:
    packet = encode(message)
    assert refused(packet[: data.draw(st.integers(0, len(packet) - 1))])


@given(messages, st.binary(min_size=1, max_size=9))
def test_what_follows_a_message_is_refused(message: Any, more: bytes) -> None:
    assert refused(encode(message) + more)


@given(messages, st.data())
def test_a_damaged_message_raises_nothing_else(message: Any, data: st.DataObject) -> None:
    packet = bytearray(encode(message))
    packet[data.draw(st.integers(0, len(packet) - 1))] ^= data.draw(st.integers(1, 255))
    taken_or_malformed(bytes(packet))


wrong = st.one_of(
    st.none(),
    st.text(),
    st.floats(),
    st.binary(),
    st.lists(st.integers(-(2**63), 2**64 - 1)),
    st.dictionaries(numbers, numbers),
)


@given(messages, wrong, st.data())
def test_a_field_of_another_type_raises_nothing_else(message: Any, value: Any, data: st.DataObject) -> None:
    parts = msgspec.msgpack.decode(encode(message))
    parts[data.draw(st.integers(0, len(parts) - 1))] = value
    taken_or_malformed(msgspec.msgpack.encode(parts))


@given(messages)
def test_a_missing_or_another_field_is_refused(message: Any) -> None:
    parts = msgspec.msgpack.decode(encode(message))
    assert refused(msgspec.msgpack.encode([*parts, None]))
    assert refused(msgspec.msgpack.encode(["other", *parts[1:]]))
    assert refused(msgspec.msgpack.encode({"type": parts[0]}))


PROGRAM = Program(1, 1, b"", 0.0, (Stage(b"", 0.0),), True, False, "a")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf"), 1e13])
def test_a_time_that_is_none_is_refused(value: float) -> None:
    replace = msgspec.structs.replace
    for message in (
        replace(PROGRAM, begin=value),
        replace(PROGRAM, stages=(Stage(b"", value),)),
        replace(PROGRAM, stages=(Stage(b"", 0.0, settled=value),)),
        Setpoint(1, 1, b"", (), value, False, ""),
    ):
        assert refused(encode(message))


@pytest.mark.parametrize(
    "message",
    [
        Cancel(-1, None, ""),
        Cancel(2**63, None, ""),
        Cancel(1, None, "x" * 1_001),
        Counts((-1,)),
        Hello(VERSION, "driver", "arm"),  # type: ignore[arg-type]
        msgspec.structs.replace(PROGRAM, start=b"\0" * (MOST_ACTUATORS // 8 + 1)),
        msgspec.structs.replace(PROGRAM, context=b"\0" * 8_193),
        msgspec.structs.replace(PROGRAM, stages=(Stage(b"", 0.0),) * (MOST_STAGES + 1)),
        msgspec.structs.replace(PROGRAM, stages=(Stage(b"\0" * 100, 0.0),) * MOST_STAGES),
        Replacement(1, 1, 0, b"", (Stage(b"", 0.0, mark=-2),), True),
    ],
)
def test_what_is_out_of_bounds_is_refused(message: Any) -> None:
    assert refused(encode(message))


def test_what_is_too_large_is_refused_unread_and_by_its_size() -> None:
    assert refused(encode(Alive()) * MOST_BYTES).startswith("the message has ")


def test_what_is_nested_too_deep_is_refused() -> None:
    assert refused(b"\x91" * 60_000)


@given(st.integers(1, 300), st.data())
def test_states_are_packed_and_unpacked(actuators: int, data: st.DataObject) -> None:
    bits = data.draw(st.integers(0, (1 << actuators) - 1))
    packed = pack(bits, actuators)
    assert len(packed) == (actuators + 7) // 8
    assert unpack(packed) == bits
    assert all(packed[k // 8] >> (k % 8) & 1 == bits >> k & 1 for k in range(actuators))
