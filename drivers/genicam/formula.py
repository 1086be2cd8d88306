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
LARGEST_SHIFT = 64
LARGEST_BASE = 1e9

_TOKEN = re.compile(
    r"\s*(0[xX][0-9a-fA-F]+|\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+|[A-Za-z_][\w.]*"
    r"|\*\*|<<|>>|<>|<=|>=|&&|\|\||!=|==|[-+*/%&|^~!=<>?:(),])"
)
_LEVELS: tuple[tuple[str, ...], ...] = (  # the loosest first; a choice is looser than all
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("=", "==", "<>", "!="), ("<", ">", "<=", ">="),
    ("<<", ">>"), ("+", "-"), ("*", "/", "%"), ("**",),
)  # fmt: skip
_BINDING = {sign: level for level, signs in enumerate(_LEVELS) for sign in signs}
_SIGNS = {"+": "u+", "-": "u-", "~": "u~", "!": "u!"}
_OPENING = ("(", "call")
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
        return _Stack(values).result(_tokens(formula))
    except _NoFormula:
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


class _Stack:
    """Dijkstra's two stacks, values and operators: the depth of a formula costs no recursion."""

    def __init__(self, values: Values) -> None:
        self._known = values
        self._values: list[Number | None] = []
        self._signs: list[str] = []
        self._calls: list[int] = []  # values below each open call

    def result(self, tokens: list[str]) -> Number | None:
        """Go through the tokens from left to right."""
        operand = True  # what may come next
        for place, token in enumerate(tokens):
            following = tokens[place + 1] if place + 1 < len(tokens) else ""
            operand = self._begin(token, following) if operand else self._go_on(token)
        if operand:
            raise _NoFormula
        self._apply_to("")
        if self._signs or len(self._values) != 1:
            raise _NoFormula
        return self._values[0]

    def _begin(self, token: str, following: str) -> bool:
        """A token where an operand begins; returns whether one may still come."""
        if token in _SIGNS:
            self._signs.append(_SIGNS[token])
            return True
        if token == "(":
            if self._signs[-1:] != ["name"]:
                self._signs.append("(")
            else:
                self._signs[-1] = "call"
            return True
        if token[0].isdigit() or token[0] == ".":
            self._values.append(_number(token))
            return False
        if not (token[0].isalpha() or token[0] == "_"):
            raise _NoFormula
        if following == "(":
            self._signs.append("name")
            self._calls.append(len(self._values))
            return True
        self._values.append(self._known(token))
        return False

    def _go_on(self, token: str) -> bool:
        """A token after an operand; returns whether another one must come."""
        if token == ")":
            self._close()
            return False
        if token == ",":
            if self._apply_to("call") != "call":
                raise _NoFormula
        elif token == "?":
            self._apply_while(lambda sign: sign in _BINDING or sign[0] == "u")
            self._signs.append("?")
        elif token == ":":
            if self._apply_to("?") != "?":
                raise _NoFormula
            self._signs[-1] = "?:"
        elif token in _BINDING:
            level = _BINDING[token] + (token == "**")  # powers bind to the right
            self._apply_while(lambda sign: sign[0] == "u" or _BINDING.get(sign, -1) >= level)
            self._signs.append(token)
        else:
            raise _NoFormula
        return True

    def _close(self) -> None:
        if self._apply_to("") == "call":  # a function: its arguments are read, its value is unknown
            del self._values[self._calls.pop() :]
            self._values.append(None)
        elif not self._signs or self._signs[-1] != "(":
            raise _NoFormula
        self._signs.pop()

    def _apply_to(self, wanted: str) -> str:
        """Apply operators down to a parenthesis or to `wanted`, and return what is there."""
        self._apply_while(lambda sign: sign not in (*_OPENING, "name", "?") and sign != wanted)
        return self._signs[-1] if self._signs else ""

    def _apply_while(self, binds: Callable[[str], bool]) -> None:
        while self._signs and binds(self._signs[-1]):
            self._apply(self._signs.pop())

    def _apply(self, sign: str) -> None:
        count = 1 if sign[0] == "u" else 3 if sign == "?:" else 2
        operands = self._values[-count:]
        del self._values[-count:]
        if len(operands) < count:
            raise _NoFormula
        try:
            self._values.append(_applied(sign, operands))
        except (OverflowError, ZeroDivisionError, ValueError):
            self._values.append(None)


def _number(token: str) -> Number:
    if token[:2].lower() == "0x":
        return int(token, 16)
    return int(token) if token.isdecimal() else float(token)


def _applied(sign: str, operands: list[Number | None]) -> Number | None:
    if sign == "?:":
        return _chosen(*operands)
    if sign[0] == "u":
        return None if operands[0] is None else _signed(sign[1], operands[0])
    left, right = operands
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
    return _arithmetic(sign, left, right)


def _chosen(asked: Number | None, first: Number | None, second: Number | None) -> Number | None:
    if asked is None:
        return first if first == second else None
    return first if asked else second


def _signed(sign: str, value: Number) -> Number:
    if sign == "!":
        return int(not value)
    if sign == "~":
        return ~int(value)
    return -value if sign == "-" else value


def _logical(sign: str, left: Number | None, right: Number | None) -> Number | None:
    sides = [None if side is None else bool(side) for side in (left, right)]
    deciding = sign == "||"
    if deciding in sides:
        return int(deciding)
    return None if None in sides else int(not deciding)


def _arithmetic(sign: str, left: Number, right: Number) -> Number | None:
    whole = isinstance(left, int) and isinstance(right, int)
    found: Number
    if sign in ("**", "<<", ">>"):
        return _scaled(sign, left, right)
    if sign == "+":
        found = left + right
    elif sign == "-":
        found = left - right
    elif sign == "*":
        found = left * right
    elif sign == "/":
        found = math.trunc(left / right) if whole else left / right
    else:
        found = int(math.fmod(left, right)) if whole else math.fmod(left, right)
    return found if abs(found) < 1 << 128 else None  # a longer product would not end


def _scaled(sign: str, left: Number, right: Number) -> Number | None:
    if abs(right) > LARGEST_SHIFT or abs(left) > 1 << 64:
        return None
    if sign == "**":
        found = left**right if abs(left) <= LARGEST_BASE else None
        return found if isinstance(found, int | float) else None
    if right < 0:
        return None
    return int(left) << int(right) if sign == "<<" else int(left) >> int(right)
