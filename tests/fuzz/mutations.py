"""One generator of mutations for all readers: odd bytes, odd values and odd lengths in a valid message."""

from __future__ import annotations

import random
import re
from collections.abc import Sequence

from tests.fuzz.requests import spoiler

HEAD = b"\n"  # ends the key, or the name of a file, before a payload
# A byte that UTF-8 never has, a cut sequence, a surrogate, five bytes, NUL in two bytes; a byte order mark; NUL.
ODD = (b"\xff", b"\xc3\x28", b"\xed\xa0\x80", b"\xf8\x88\x80\x80\x80", b"\xc0\x80", b"\xef\xbb\xbf", b"\0")
TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*"|-?\d[0-9.eE+-]*|true|false|null')
VALUES = (
    *(b"1e400", b"-1e400", b"-0", b"-0.0", b"1e-400", b"1E+999999999999", b"NaN", b"Infinity", b"-Infinity"),
    *(b"9" * 400, b"9" * 5000, b"0.1" + b"0" * 2000, b"18446744073709551616", b"9223372036854775808", b"1e308"),
    *(b'"\\ud800"', b'"\\udc00x"', b'"a\xffb"', b'"\\u0000"', b'"\\u001b[2J"', b'""', b"'a'", b'"[/]"'),
    *(b"null", b"true", b"[]", b"{}", b"[null]", b'{"":{}}', b"[[1]]", b"[1e400]", b'{"a":1,"a":2}'),
    *(b"-1", b"7", b"0.5", b"", b"[" * 200 + b"]" * 200),
)  # fmt: skip
LONG = (b'"' + b"x" * 1_500_000 + b'"', b"[" * 200_000, b"[" * 5_000 + b"]" * 5_000, b'{"a":' * 5_000, b"9" * 1_000_000)
RARELY = 0.002  # share of the inputs with a value of LONG


def mutated(seeds: Sequence[bytes], chance: random.Random) -> bytes:
    """Returns one of the seeds with one to three changes; a head that ends with HEAD is kept."""
    seed = chance.choice(seeds)
    head, separator, data = seed.partition(HEAD) if HEAD in seed[:200] else (b"", b"", seed)
    other = chance.choice(seeds).partition(HEAD)[2]
    if chance.random() < RARELY:
        return head + separator + replaced(data, chance, LONG)
    for _ in range(chance.choice((1, 1, 2, 3))):
        data = changed(data, other, chance)
    return head + separator + data


def changed(data: bytes, other: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data) + 1)
    to = min(at + chance.choice((1, 2, 8, 100)), len(data))
    match chance.randrange(12):
        case 0 | 1 | 2:
            return replaced(data, chance, VALUES)
        case 3 | 4 | 5:
            return spoiler({})(data, chance)
        case 6 | 7:
            return data[:at] + chance.choice(ODD) + data[chance.choice((at, at, at + 1)) :]
        case 8:
            return data[:at]
        case 9:
            return data[:at] + chance.choice((b"", data[at:to] * 2, chance.randbytes(4))) + data[to:]
        case 10:
            return data[:at] + bytes([chance.randrange(256)]) + data[at + 1 :]
        case _:
            return chance.choice((other, data[:at] + other[-at:], b"", chance.randbytes(chance.choice((1, 9, 60)))))


def replaced(data: bytes, chance: random.Random, values: Sequence[bytes]) -> bytes:
    """Replaces a text, a number or a word of JSON by another value."""
    tokens = list(TOKEN.finditer(data))
    if not tokens:
        return chance.choice(values)
    token = chance.choice(tokens)
    return data[: token.start()] + chance.choice(values) + data[token.end() :]
