"""Remember what was worked out for a class, so that it is worked out once."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar, cast

R = TypeVar("R")


def once(make: Callable[[type[Any]], R]) -> Callable[[type[Any]], R]:
    """`lru_cache` for functions of a class, with a type that mypy accepts for classes."""
    return cast(Callable[[type[Any]], R], lru_cache(maxsize=256)(make))
