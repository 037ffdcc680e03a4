"""Damaged copies of a file: a few random changes of bytes, and of words and numbers where it is text."""

import re
import struct
from collections.abc import Callable, Sequence
from random import Random

WORDS = ["0", "-1", "1", "2", "1.5", "-0.0", "1e300", "-1e300", "1e-300", "nan", "NaN", "inf", "-Infinity"]
WORDS += ["99999999", "4294967295", "-2147483648", "1" + "0" * 30, "9" * 400, "", "x", "null", "true", "[]", "{}", '""']
WORDS += ["../x", "/dev/null", "a" * 3000, "é\u202e\U0001f600", "\x00", "[" * 200, "]" * 5, "<!--", "-->", "#", "/"]
NUMBERS = [0, 1, 2, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1]
FLOATS = [float("nan"), float("inf"), -1.0, 1e30, 1e300]
TOKEN = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?|[A-Za-z_]\w*|\S")
MOST = 1 << 20  # bytes of a damaged file


def damaged(data: bytes, random: Random, text: bool) -> bytes:
    """The data with one to four changes."""
    changes = [*BYTES, *WORDS_AND_LINES] if text else BYTES
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        data = random.choice(changes)(data, random)[:MOST]
    return data


def _piece(data: bytes, random: Random) -> tuple[int, int]:
    start = random.randrange(len(data) + 1)
    return start, min(len(data), start + random.choice((1, 2, 4, 8, 32, 128, len(data))))


def _flip(data: bytes, random: Random) -> bytes:
    if not data:
        return b"\x00"
    at = random.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]


def _number(data: bytes, random: Random) -> bytes:
    """An extreme number over the bytes that are there."""
    order = random.choice("<>")
    if random.random() < 0.3:
        kind, value = random.choice("fd"), random.choice(FLOATS)
        packed = struct.pack(order + kind, value if kind == "d" else min(max(value, -3e38), 3e38))
    else:
        size = random.choice((1, 2, 4, 8))
        packed = (random.choice(NUMBERS) % 256**size).to_bytes(size, "little" if order == "<" else "big")
    at = random.randrange(len(data) + 1)
    return data[:at] + packed + data[at + len(packed) :]


def _cut(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _drop(data: bytes, random: Random) -> bytes:
    start, end = _piece(data, random)
    return data[:start] + data[end:]


def _repeat(data: bytes, random: Random) -> bytes:
    start, end = _piece(data, random)
    return data[:start] + data[start:end] * random.choice((2, 3, 100)) + data[end:]


def _noise(data: bytes, random: Random) -> bytes:
    start, end = _piece(data, random)
    return data[:start] + random.randbytes(min(end - start, 256)) + data[end:]


def _tokens(data: bytes) -> Sequence[re.Match]:
    return list(TOKEN.finditer(data))


def _other_word(data: bytes, random: Random) -> bytes:
    """A word or a number of the text becomes another one."""
    found = _tokens(data)
    if not found:
        return random.choice(WORDS).encode()
    token = random.choice(found)
    new = random.choice(WORDS).encode() if random.random() < 0.7 else random.choice(found).group()
    return data[: token.start()] + new + data[token.end() :]


def _other_number(data: bytes, random: Random) -> bytes:
    found = [token for token in _tokens(data) if token.group()[-1:].isdigit()]
    if not found:
        return _other_word(data, random)
    token = random.choice(found)
    return data[: token.start()] + random.choice(WORDS[:18]).encode() + data[token.end() :]


def _lines(data: bytes, random: Random) -> bytes:
    """Lines are dropped, repeated or swapped."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return b"\n"
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    match random.randrange(3):
        case 0:
            del lines[at]
        case 1:
            lines[at] *= random.choice((2, 500))
        case _:
            lines[at], lines[other] = lines[other], lines[at]
    return b"".join(lines)


def _insert(data: bytes, random: Random) -> bytes:
    at = random.randrange(len(data) + 1)
    return data[:at] + random.choice(WORDS).encode() + data[at:]


Change = Callable[[bytes, Random], bytes]
BYTES: list[Change] = [_flip, _number, _cut, _drop, _repeat, _noise]
WORDS_AND_LINES: list[Change] = [_other_word, _other_word, _other_number, _other_number, _lines, _insert]
