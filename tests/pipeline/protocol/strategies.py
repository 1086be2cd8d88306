"""Strategies for every message of the protocol, derived from the types of its fields."""

import dataclasses
import typing
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union

import msgspec
from hypothesis import strategies as st

from pipeline.bus.inbox import InboxPosition
from pipeline.bus.network import Network
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.graph.ports import InputPort, Ports
from pipeline.protocol import codec, fleet, handover, orders, questions, supervision

MODULES = (codec, fleet, handover, orders, questions, supervision)
PLAN = load(Path(__file__).parents[3] / "graphs" / "tracking.yaml")
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
WHOLE = st.integers(-(1 << 63), (1 << 64) - 1)
PLAIN = st.recursive(
    st.none() | st.booleans() | WHOLE | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=4,
)


def message_classes() -> list[type[codec.ControlMessage]]:
    """Return every message class of the protocol."""
    found = [cls for module in MODULES for cls in vars(module).values() if isinstance(cls, type)]
    messages = [c for c in found if issubclass(c, codec.ControlMessage)]
    return sorted({*messages} - {codec.ControlMessage}, key=lambda cls: cls.__name__)


def messages(cls: type[Any]) -> st.SearchStrategy[Any]:
    """Return a strategy for a message class or for a part of one."""
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = {name: of_type(hints[name]) for name in cls.__struct_fields__}
    return st.builds(cls, **fields)


def of_type(hint: Any) -> st.SearchStrategy[Any]:
    """Return a strategy for a type that a field may have."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return _limited(arguments[0], arguments[1])
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin in (Union, UnionType):
        return st.one_of(*map(of_type, arguments))
    if origin in (dict, Mapping):
        return st.dictionaries(of_type(arguments[0]), of_type(arguments[1]), max_size=3)
    if origin is list:
        return st.lists(of_type(arguments[0]), max_size=3)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(of_type(arguments[0]), max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*map(of_type, arguments))
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return messages(hint)
    if dataclasses.is_dataclass(hint) and hint not in SIMPLE:
        kinds = typing.get_type_hints(hint)
        return st.builds(hint, **{f.name: of_type(kinds[f.name]) for f in dataclasses.fields(hint)})
    return SIMPLE[hint]


def _limited(hint: Any, meta: Any) -> st.SearchStrategy[Any]:
    if hint is str:
        return st.text("az_", max_size=min(8, meta.max_length))
    make = st.integers if hint is int else st.floats
    return make(meta.ge, meta.le)


INPUT_PORTS = st.builds(
    InputPort, message=TEXT, join=st.booleans(), optional=st.booleans(), command=st.booleans(),
    tap=st.booleans(),
)  # fmt: skip
PORTS = st.builds(
    Ports, inputs=st.dictionaries(TEXT, INPUT_PORTS, max_size=3),
    outputs=st.dictionaries(TEXT, TEXT, max_size=3), source=st.booleans(),
)  # fmt: skip
SIMPLE: dict[Any, st.SearchStrategy[Any]] = {
    Any: PLAIN, str: TEXT, int: WHOLE, float: st.floats(allow_nan=False), bool: st.booleans(),
    bytes: st.binary(max_size=8), type(None): st.none(), Plan: st.just(PLAN), Ports: PORTS,
    Network: st.just(Network(listen=("tls/a:1",), credentials="here")),
    InboxPosition: st.just(InboxPosition("s", ["r"], 3, {"frame": 2})),
}  # fmt: skip
