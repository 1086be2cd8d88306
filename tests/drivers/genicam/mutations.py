"""Damaged descriptions: a text and a seed in, the text with a few places changed out."""

import random
import re

WORDS = (
    b"", b"0", b"-1", b"1", b"4294967295", b"99999999999999999999", b"0x", b"1e999", b"\xff\xfe",
    b"Width", b"WidthRegister", b"OffsetX", b"TLParamsLocked", b"Nothing", b"a" * 3000, b"&amp;",
    b"]]>", b"<!DOCTYPE x [<!ENTITY y 'z'>]>", b"<Value>1</Value>", b"(", b"1/0", b"A?B", b"1<<70",
)  # fmt: skip
_TEXT = re.compile(rb">([^<>]+)<")
_ELEMENT = re.compile(rb"<(\w+)(?: [^<>]*)?>[^<>]*</\1>")


def mutated(text: bytes, seed: int) -> bytes:
    """One to four changes of one kind each, the same for the same seed."""
    draw = random.Random(seed)
    for _ in range(draw.randint(1, 4)):
        text = draw.choice((_flip, _reword, _cut, _repeat, _swap, _end))(text, draw)
    return text


def _flip(text: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(max(len(text), 1))
    return text[:at] + bytes([draw.randrange(256)]) + text[at + 1 :]


def _reword(text: bytes, draw: random.Random) -> bytes:
    found = list(_TEXT.finditer(text))
    if not found:
        return text
    one = draw.choice(found)
    names = [m[1] for m in found]
    word = draw.choice((*WORDS, *draw.sample(names, min(3, len(names)))))
    return text[: one.start(1)] + word + text[one.end(1) :]


def _cut(text: bytes, draw: random.Random) -> bytes:
    found = list(_ELEMENT.finditer(text))
    if not found:
        return text
    one = draw.choice(found)
    return text[: one.start()] + text[one.end() :]


def _repeat(text: bytes, draw: random.Random) -> bytes:
    found = list(_ELEMENT.finditer(text))
    if not found:
        return text
    one, place = draw.choice(found), draw.choice(found)
    return text[: place.start()] + one[0] + text[place.start() :]


def _swap(text: bytes, draw: random.Random) -> bytes:
    found = list(_TEXT.finditer(text))
    if len(found) < 2:
        return text
    first, second = sorted(draw.sample(found, 2), key=lambda m: m.start())
    return (
        text[: first.start(1)] + second[1] + text[first.end(1) : second.start(1)]
        + first[1] + text[second.end(1) :]
    )  # fmt: skip


def _end(text: bytes, draw: random.Random) -> bytes:
    return text[: draw.randrange(max(len(text), 1))] if draw.random() < 0.3 else text
