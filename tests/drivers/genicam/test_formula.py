"""Formulas of descriptions: the grammar, and what follows when a value is not known."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.formula import compute

KNOWN = {"ONE": 1, "ZERO": 0, "X": 7, "R.Value": 3}.get


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3", 7), ("(1 + 2) * 3", 9), ("2 ** 3 ** 2", 512), ("-X + 10", 3), ("7 / 2", 3),
        ("7.0 / 2", 3.5), ("-7 % 4", -3), ("0x1F & 0x0F", 15), ("1 << 4 | 1", 17), ("6 ^ 3", 5),
        ("~0", -1), ("!X", 0), ("X = 7", 1), ("X <> 7", 0), ("X != 6", 1), ("X >= 8", 0),
        ("X = 7 && ONE", 1), ("ZERO || ZERO", 0), ("X > 5 ? 10 : 20", 10), ("R.Value * 2", 6),
        ("ZERO ? 1 : ZERO ? 2 : 3", 3), ("1e3 + .5", 1000.5),
    ],
)  # fmt: skip
def test_the_grammar_is_that_of_the_standard(text: str, value: float) -> None:
    assert compute(text, KNOWN) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("ONE || U", 1), ("U || ONE", 1), ("ZERO && U", 0), ("U && ZERO", 0), ("U & 0", 0),
        ("ZERO || U", None), ("ONE && U", None), ("U + 1", None), ("!U", None), ("U = 1", None),
        ("U ? 4 : 4", 4), ("U ? 4 : 5", None), ("ONE ? 4 : U", 4), ("SIN(U)", None),
        ("((U = 1) && (ZERO = 1)) || ((ONE = 1) && (X = 7)) ? 1 : 0", 1),
    ],
)  # fmt: skip
def test_an_unknown_value_matters_only_where_it_decides(text: str, value: float | None) -> None:
    assert compute(text, KNOWN) == value


@pytest.mark.parametrize(
    "text",
    [
        "", "1 +", "(1", "1)", "1 2", "$", "1/0", "X %% 2", "9 ** 9 ** 9", "1 << 99", "F(1,", "F(",
        "F()", "(1, 2)", "(" * 500, "-" * 4000, "ONE ? 1", "1 : 2", "1 ? 2 : 3 : 4", ",", "1 ? : 2",
        "1+" * 3000 + "1", "? 1 : 2", "()",
    ],
)  # fmt: skip
def test_what_is_no_formula_has_no_value(text: str) -> None:
    assert compute(text, KNOWN) is None


TREES = st.recursive(
    st.integers(0, 99).map(lambda n: (str(n), n)),
    lambda inner: st.tuples(inner, st.sampled_from("+-*&|^"), inner).map(
        lambda t: (f"({t[0][0]} {t[1]} {t[2][0]})", applied(t[1], t[0][1], t[2][1]))
    ),
    max_leaves=12,
)


def applied(sign: str, left: int, right: int) -> int:
    return {
        "+": left + right, "-": left - right, "*": left * right, "&": left & right,
        "|": left | right, "^": left ^ right,
    }[sign]  # fmt: skip


@given(TREES)
def test_whole_numbers_are_computed_as_python_does(tree: Any) -> None:
    text, value = tree

    assert compute(text, KNOWN) == value


def test_depth_costs_nothing() -> None:
    assert compute("(" * 1500 + "X" + ")" * 1500, KNOWN) == 7
    assert compute("!" * 4000 + "X", KNOWN) == 1
    assert compute("1?" * 900 + "X" + ":2" * 900, KNOWN) == 7


@given(st.text("0123456789.xXUE()+-*/%&|^~!=<>?: ,", max_size=60))
def test_no_text_breaks_it(text: str) -> None:
    found = compute(text, KNOWN)

    assert found is None or isinstance(found, int | float)
