"""Literals of metadata: what Python and JSON print is read, anything else is one sentence."""

import json
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.saliency.literals import DEEPEST, MOST_CHARS, MOST_VALUES, parse

NUMBERS = st.integers(-(10**17), 10**17) | st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
SCALARS = st.none() | st.booleans() | NUMBERS | TEXTS


def tables(keys: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    return st.recursive(
        SCALARS,
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4),
        max_leaves=12,
    ).filter(lambda value: depth(value) <= DEEPEST)


def depth(value: object) -> int:
    """Levels of a value; 1 for a scalar."""
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(depth, parts), default=0)


def refusal(text: str) -> str:
    """The sentence that refuses a text, "" for a literal."""
    try:
        parse(text)
    except ValueError as error:
        return str(error)
    return ""


@given(tables(st.integers(0, 10**6) | TEXTS))
def test_what_python_prints_is_read(value: object) -> None:
    assert parse(repr(value)) == value


@given(tables(TEXTS))
def test_what_json_prints_is_read(value: object) -> None:
    assert parse(json.dumps(value, ensure_ascii=False)) == value


def test_every_escape_sequence_of_json_is_read() -> None:
    assert parse(r'"\b\f\n\r\t\/\\\" \u00e9"') == '\b\f\n\r\t/\\" é'


@given(st.text(max_size=60) | st.text("{}[]():,'\"\\xu0 19.-eTrueNon\n", max_size=60))
def test_any_text_is_read_or_refused_in_a_sentence(text: str) -> None:
    sentence = refusal(text)

    assert not sentence or sentence.startswith("expected ")
    assert sentence.isprintable()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "expected a value at character 1, got the end"),
        ("{0: 'a' 1: 'b'}", "expected a comma or } at character 8"),
        ("{0: 'a', 0: 'b'}", "expected another whole number or text as a key at character 9"),
        ("{True: 'a'}", "expected another whole number or text as a key"),
        ("{0 'a'}", "expected a colon"),
        ("[1] [2]", "expected the end"),
        ("__import__('os')", "expected a value at character 1"),
        ("1 + 1", "expected a value at character 2"),
        ("1e999", "expected a finite number"),
        ("9" * 19, "expected a value"),
        (r"'\q'", "expected a known escape sequence"),
        (r"'\Uffffffff'", "expected a known escape sequence"),
        ("[" * 9 + "]" * 9, "expected up to 8 levels"),
    ],
)
def test_what_is_no_literal_is_refused(text: str, sentence: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        parse(text)

    assert str(caught.value).startswith(sentence)


@pytest.mark.parametrize(
    "text",
    [
        "[" * MOST_CHARS,
        "-" * MOST_CHARS,
        "'" + "a" * (MOST_CHARS - 1),
        "[" + "1," * (MOST_VALUES + 1) + "]",
        " " * (MOST_CHARS + 1),
        "'" + "\\" * (MOST_CHARS - 2) + "x",
    ],
    ids=["brackets", "signs", "no end", "values", "characters", "escapes"],
)
def test_long_texts_are_refused_at_once(text: str) -> None:
    began_s = time.process_time()

    with pytest.raises(ValueError, match="expected"):
        parse(text)

    assert time.process_time() - began_s < 2
