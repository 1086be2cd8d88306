"""Formulas of a camera's description: text and values in, a number or "not known" out.

The grammar is that of GenApi's SwissKnife (GenICam Standard 2.1, section 2.8.14): C's operators
with `=` for equality, `<>` for inequality and `**` for powers. A value that is not known gives an
answer where the other operand decides (`1 || x` is 1); otherwise the answer is not known, either.
"""

import math
import operator
import re
from collections.abc import Callable, Mapping

Number = int | float
Values = Callable[[str], Number | None]

LONGEST = 4096  # characters
DEEPEST = 64  # parentheses within one another
LARGEST_SHIFT = 64

_TOKEN = re.compile(
    r"\s*(0[xX][0-9a-fA-F]+|\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+|[A-Za-z_][\w.]*"
    r"|\*\*|<<|>>|<>|<=|>=|&&|\|\||!=|==|[-+*/%&|^~!=<>?:(),])"
)
_LEVELS: tuple[tuple[str, ...], ...] = (
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("=", "==", "<>", "!="), ("<", ">", "<=", ">="),
    ("<<", ">>"), ("+", "-"), ("*", "/", "%"),
)  # fmt: skip
_COMPARE: Mapping[str, Callable[[Number, Number], bool]] = {
    "=": operator.eq, "==": operator.eq, "<>": operator.ne, "!=": operator.ne,
    "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
}  # fmt: skip
_WHOLE: Mapping[str, Callable[[int, int], int]] = {
    "|": operator.or_, "^": operator.xor, "&": operator.and_,
}  # fmt: skip


def compute(formula: str, values: Values) -> Number | None:
    """The value of a formula; None: not known, also for a formula that is none.

    >>> known = {"TLP": 1}.get
    >>> compute("TLP || LCK", known), compute("TLP && LCK", known), compute("(TLP=1)?0x10:2", known)
    (1, None, 16)
    """
    if len(formula) > LONGEST:
        return None
    try:
        return _Parser(_tokens(formula), values).whole()
    except (_NoFormula, OverflowError, ZeroDivisionError, ValueError):
        return None


class _NoFormula(Exception):
    """The text is not a formula of this grammar."""


def _tokens(formula: str) -> list[str]:
    found, at = [], 0
    text = formula.strip()
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _NoFormula
        found.append(match[1])
        at = match.end()
    return found


class _Parser:
    """Recursive descent; every level of the grammar is one call."""

    def __init__(self, tokens: list[str], values: Values) -> None:
        self._tokens, self._values = tokens, values
        self._at = self._depth = 0

    def whole(self) -> Number | None:
        found = self._choice()
        if self._at < len(self._tokens):
            raise _NoFormula
        return found

    def _choice(self) -> Number | None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise _NoFormula
        found = self._binary(0)
        if self._taken("?"):
            first = self._choice()
            self._need(":")
            second = self._choice()
            if found is None:
                found = first if first == second else None
            else:
                found = first if found else second
        self._depth -= 1
        return found

    def _binary(self, level: int) -> Number | None:
        if level == len(_LEVELS):
            return self._power()
        found = self._binary(level + 1)
        while self._peek() in _LEVELS[level]:
            sign = self._next()
            found = _applied(sign, found, self._binary(level + 1))
        return found

    def _power(self) -> Number | None:
        base = self._unary()
        if not self._taken("**"):
            return base
        self._depth += 1
        if self._depth > DEEPEST:
            raise _NoFormula
        exponent = self._power()
        self._depth -= 1
        if base is None or exponent is None or abs(exponent) > LARGEST_SHIFT or abs(base) > 1e9:
            return None
        found = base**exponent
        return found if isinstance(found, int | float) else None

    def _unary(self) -> Number | None:
        signs = []
        while self._peek() in ("+", "-", "~", "!"):
            signs.append(self._next())
        found = self._atom()
        for sign in reversed(signs):
            found = None if found is None else _unary(sign, found)
        return found

    def _atom(self) -> Number | None:
        token = self._next()
        if token == "(":
            found = self._choice()
            self._need(")")
            return found
        if token[0].isdigit() or token[0] == ".":
            return _number(token)
        if not (token[0].isalpha() or token[0] == "_"):
            raise _NoFormula
        if not self._taken("("):
            return self._values(token)
        while True:  # a function: its arguments are read, its value is not known
            self._choice()
            if not self._taken(","):
                break
        self._need(")")
        return None

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _next(self) -> str:
        token = self._peek()
        if not token:
            raise _NoFormula
        self._at += 1
        return token

    def _taken(self, token: str) -> bool:
        found = self._peek() == token
        self._at += found
        return found

    def _need(self, token: str) -> None:
        if not self._taken(token):
            raise _NoFormula


def _number(token: str) -> Number:
    if token[:2].lower() == "0x":
        return int(token, 16)
    found = float(token)
    return int(token) if token.isdigit() else found


def _unary(sign: str, value: Number) -> Number:
    if sign == "!":
        return int(not value)
    if sign == "~":
        return ~int(value)
    return -value if sign == "-" else value


def _applied(sign: str, left: Number | None, right: Number | None) -> Number | None:
    if sign in ("||", "&&"):
        return _logical(sign, left, right)
    if sign == "&" and 0 in (left, right):
        return 0
    if left is None or right is None:
        return None
    if sign in _COMPARE:
        return int(_COMPARE[sign](left, right))
    if sign in _WHOLE:
        return _WHOLE[sign](int(left), int(right))
    if sign in ("<<", ">>"):
        if not 0 <= right <= LARGEST_SHIFT:
            return None
        shift = operator.lshift if sign == "<<" else operator.rshift
        return int(shift(int(left), int(right)))
    return _arithmetic(sign, left, right)


def _logical(sign: str, left: Number | None, right: Number | None) -> Number | None:
    sides = [None if side is None else bool(side) for side in (left, right)]
    deciding = sign == "||"
    if deciding in sides:
        return int(deciding)
    return None if None in sides else int(not deciding)


def _arithmetic(sign: str, left: Number, right: Number) -> Number | None:
    if sign == "+":
        found = left + right
    elif sign == "-":
        found = left - right
    elif sign == "*":
        found = left * right
    elif sign == "/":
        found = left / right
        if isinstance(left, int) and isinstance(right, int):
            found = math.trunc(found)
    else:
        found = math.fmod(left, right)
        if isinstance(left, int) and isinstance(right, int):
            found = int(found)
    return found
