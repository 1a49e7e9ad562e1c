"""Mutations of valid messages, drawn from a random generator: parts of JSON, and bytes."""

from __future__ import annotations

import json
import math
import random
import re
import struct
from typing import Any

from hypothesis import strategies as st

VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 2, 7, 63, 64, 127, 10_000, 10_001, 1 << 64, -(1 << 63), 10**400, 0.5,
    0.0, -0.0, 1e-9, 5e-324, 1e6, 1e308, -1e308, math.nan, math.inf, -math.inf,
    "", "a", "1", "nan", "can0", "vgt", "*", "\ud800", "x" * 2000, "\0", "\n", "\x1b[2J", "[/]", "ä",
    [], {}, [[]], [None], [0, 0], [1, 2, 3, 4], {"": 0}, {"a": 1},
]  # fmt: skip
# JSON that no value has: numbers too great or too long, texts of no UTF-8, the same key twice, deep nesting.
WORDS = (
    *(b"1e400", b"-0", b"1e-400", b"1E+999999999999", b"9" * 5000, b"0.1" + b"0" * 2000, b'"a\xffb"', b"'a'", b""),
    *(b'{"a":1,"a":2}', b"[1e400]", b"[" * 200 + b"]" * 200),
)
LONG = (b'"' + b"x" * 1_500_000 + b'"', b"[" * 200_000, b"[" * 5_000 + b"]" * 5_000, b'{"a":' * 5_000, b"9" * 1_000_000)
RARELY = 0.002  # share of the mutations that put in a word of LONG
TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*"|-?\d[0-9.eE+-]*|true|false|null')
# A byte that UTF-8 never has, a cut sequence, a surrogate, five bytes, NUL in two bytes; a byte order mark; NUL.
ODD = (b"\xff", b"\xc3\x28", b"\xed\xa0\x80", b"\xf8\x88\x80\x80\x80", b"\xc0\x80", b"\xef\xbb\xbf", b"\0")
LENGTHS = (0, 1, 2, 255, 2**16, 2**20, 2**26, 2**31 - 1, 2**31, 2**32 - 4, 2**32 - 1)
NUMBERS = (0.0, 0.4, -0.5, 1.0, 2.9, 1e308, -1e308, 5e-324, 1e6, math.nan, math.inf, -math.inf)


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(path for key, part in inner for path in places(part, (*at, key)))]


def spoiled(value: Any, chance: random.Random) -> Any:
    """Returns a JSON value with one part changed, left out, doubled, renamed or nested."""
    value = json.loads(json.dumps(value))
    path = chance.choice(places(value))
    if not path:
        return chance.choice([value, [value], *VALUES])
    *way, key = path
    room = value
    for step in way:
        room = room[step]
    match chance.randrange(8):
        case 0:
            del room[key]
        case 1 if isinstance(room, list):
            room[key:key] = [room[key]] * chance.choice([1, 2, 9])
        case 1 | 2 if isinstance(room, dict):
            room[chance.choice([f"{key}s", "", "type", "count", "\ud800"])] = room[key]
        case 3:
            room[key] = [room[key]]
        case 4 if isinstance(room[key], int | float) and not isinstance(room[key], bool):
            room[key] *= chance.choice([-1, 0.5, 2, 1000, 1e-12, 1e12])
        case _:
            room[key] = chance.choice(VALUES)
    return value


def changed(data: bytes, chance: random.Random) -> bytes:
    """Returns bytes with a few of them changed, put in or left out."""
    at = chance.randrange(len(data) + 1)
    to = min(at + chance.choice((1, 2, 8, 64, 512)), len(data))
    match chance.randrange(8):
        case 0:
            return data[:at] + chance.choice(ODD) + data[chance.choice((at, at, at + 1)) :]
        case 1:
            return data[:at]
        case 2:
            return data[:at] + chance.choice((b"", data[at:to] * 2, bytes(to - at), chance.randbytes(4))) + data[to:]
        case 3:  # a length; CDR aligns these behind a header of four bytes
            at -= at % 4
            return data[:at] + struct.pack("<I", chance.choice(LENGTHS)) + data[at + 4 :]
        case 4:
            at += -at % 8 + 4
            return data[:at] + struct.pack("<d", chance.choice(NUMBERS)) + data[at + 8 :]
        case 5:
            bit = bytes([data[at] ^ 1 << chance.randrange(8)]) if at < len(data) else b""
            return data[:at] + bit + data[at + 1 :]
        case 6:
            return data[:at] + bytes([chance.randrange(256)]) + data[at + 1 :]
        case _:
            return chance.choice((b"", data[at:] + data[:at], chance.randbytes(chance.choice((1, 9, 60)))))


def mutated(data: bytes, chance: random.Random) -> bytes:
    """Returns a message with one to four changes: of its values, if it is JSON, or of its bytes."""
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        kind = chance.random()
        if kind < 0.4:
            try:
                data = json.dumps(spoiled(json.loads(data), chance)).encode()
                continue
            except (ValueError, OverflowError, RecursionError):  # no JSON, or none that can be written again
                pass
        tokens = list(TOKEN.finditer(data)) if kind < 0.6 else []
        if tokens:
            token = chance.choice(tokens)
            word = chance.choice(LONG if chance.random() < RARELY else WORDS)
            data = data[: token.start()] + word + data[token.end() :]
        else:
            data = changed(data, chance)
    return data


def wrong(*right: Any) -> st.SearchStrategy[bytes]:
    """Strategy of payloads: mutated valid values, and random bytes."""
    seeds = [json.dumps(value).encode() for value in right]
    draw = st.builds(lambda seed, number: mutated(seed, random.Random(number)), st.sampled_from(seeds), st.integers(0))
    return draw | st.binary(max_size=200)
