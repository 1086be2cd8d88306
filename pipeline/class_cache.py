"""Caches for values computed from a class."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter

R = TypeVar("R")
T = TypeVar("T")


def cached_by_class(make: Callable[[type[Any]], R]) -> Callable[[type[Any]], R]:
    """`lru_cache` for functions of a class, with a type that mypy accepts for classes."""
    return cast(Callable[[type[Any]], R], lru_cache(maxsize=256)(make))


def adapter(cls: type[T]) -> TypeAdapter[T]:
    """Return pydantic's adapter for a class, cached because building one takes 10 to 80 ms."""
    return _adapter(cls)


@cached_by_class
def _adapter(cls: type[Any]) -> TypeAdapter[Any]:
    return TypeAdapter(cls)
