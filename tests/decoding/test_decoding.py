"""The door for bytes: what cannot be read raises Unreadable, and nothing else."""

from typing import Any

import msgspec
import pytest

from hyperbit.controller.decoding.decoding import Unreadable, convert, decode, decode_once, decode_packed


class Named(msgspec.Struct):
    name: str


BYTES = [b"", b"\xff", b'"\xff"', b'{"\xff": 1}', b'"\xed\xa0\x80"', b"\xef\xbb\xbf{}", b"[" * 100_000, b"9" * 5000]
TEXTS = ['"\\ud800"', '{"\\udc00": 1}', "NaN", "[-Infinity]", "1e400", "[" * 100_000, "9" * 5000, "{", '{"a":1,"a":1}']


@pytest.mark.parametrize("kind", [Any, dict[str, Any], Named])
@pytest.mark.parametrize("data", [*BYTES, *(text.encode() for text in TEXTS[:-1])], ids=lambda it: repr(it)[:20])
def test_bytes_that_are_no_json_are_unreadable(data: bytes, kind: Any) -> None:
    with pytest.raises(Unreadable):
        decode(data, kind)


@pytest.mark.parametrize("text", TEXTS[-4:], ids=lambda it: it[:20])
def test_a_text_that_is_no_json_is_unreadable(text: str) -> None:
    with pytest.raises(Unreadable):
        decode_once(text)


@pytest.mark.parametrize("data", [b"", b"\xa1\xff", b"\xc1", b"\x91" * 100_000, b"\xdd\xff\xff\xff\xff"])
def test_bytes_that_are_no_messagepack_are_unreadable(data: bytes) -> None:
    with pytest.raises(Unreadable):
        decode_packed(data, Any)


def test_another_form_is_told_from_no_json() -> None:
    with pytest.raises(Unreadable) as other:
        decode(b'{"name": 1}', Named)
    assert other.value.form
    with pytest.raises(Unreadable) as none:
        decode(b'{"name"', Named)
    assert not none.value.form
    with pytest.raises(Unreadable):
        convert({"name": 10**400}, Named)


def test_what_can_be_read_is_read() -> None:
    assert decode(b'{"name": "a"}', Named) == decode_packed(msgspec.msgpack.encode(Named("a")), Named) == Named("a")
    assert decode_once('{"a": [-0, 1e-400, "\\ud83d\\ude00"]}') == {"a": [0, 0.0, "\U0001f600"]}
