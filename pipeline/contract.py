"""The contract of an operator: settings and messages in, messages out.

An operator is a class with frozen settings, inputs declared as class attributes, and one handler
per input (`on_<input>`) or per joined set of inputs (`on_<first>_<second>`). It runs as a process
of its own, beside others in one process, or in the in-line runner, and cannot tell which.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Generic, Literal, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import SettingsError
from pipeline.messages import Header, Message

S = TypeVar("S")
Out = TypeVar("Out")
SOURCE = "@source"  # beside the names of inputs, see `Operator.advise`
Keep = Literal["latest", "every"]
INCOMPLETE = "incomplete"  # in a summary: what could not be written, as a sentence
HEADLINE = "headline"  # in a summary: what the run showed, as a sentence
RATE = "rate"  # in the summary of a source: asked_hz and achieved_hz of its frames
Loan = Callable[[str, tuple[int, ...], DTypeLike], NDArray[Any]]  # output, shape, dtype -> memory


@dataclass(frozen=True)
class Input:
    """One typed entrance of an operator.

    Joined inputs (the rule) of one operator wait for one another and arrive as a set of equal
    `seq`. A `join=False` input has a handler of its own, `on_<input>`, which answers nothing; in
    lockstep it runs after the set of the same frame.
    """

    message: type[Message]
    keep: Keep = "latest"  # latest: drop older, counted; every: lossless, the writer waits
    depth: int = 8  # frames that may wait here (and sets in the join table)
    join: bool = True
    optional: bool = False  # the handler gets None when it is absent
    wait_ms: float = 0.0  # realtime: how long a complete set waits for its optional members
    max_age_ms: float = 0.0  # older than this since the stamp is stale; 0: never; not in lockstep
    stale: Literal["drop", "pass"] = "drop"  # drop, counted; or pass like any other, uncounted
    command: bool = False  # a sensor command: closes the loop, always the newest
    tap: bool = False  # a viewer: copies what it would otherwise pin


@dataclass(frozen=True)
class Output:
    """A named exit; an operator without one has a single exit named `out`."""

    message: type[Message]


def fresh_memory(_output: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Memory that no reader shares."""
    return np.empty(shape, dtype)


class Operator(Generic[S, Out]):
    """A part of a graph. `Out` is the message type its handlers answer with (or None: nothing).

    `__init__` only stores; `open` acquires, in the process that uses it; `close` releases after
    any outcome. Operators with named outputs answer with a mapping of output name to message.

    `live` names the settings that may change while it runs (`fovea set`), `commands` the methods
    `do_<command>` that it may be told to call (`fovea tell`).
    """

    live: ClassVar[tuple[str, ...]] = ()
    commands: ClassVar[tuple[str, ...]] = ()

    def __init__(self, settings: S, *, loan: Loan | None = None) -> None:
        self.settings = settings
        self._loan = loan or fresh_memory

    def open(self) -> None:
        """Acquire what the handlers need: models, files, devices."""

    def close(self) -> None:
        """Release everything; called after any outcome, also when `open` failed."""

    def on_stream(self, header: Header) -> None:
        """A sensor was opened anew: forget what belonged to the old stream."""

    def on_settings(self, settings: S) -> None:
        """Take over settings that differ in `live` ones, between two calls of handlers.

        They are of the right types and in range; raise `SettingsError` to refuse them all the
        same, and leave everything as it was. Of a `Source` it is called between two exposures.
        """
        self.settings = settings

    def state(self) -> object | None:
        """What must survive a swap, as one dataclass of plain values and arrays.

        One of its own that returns None says that nothing must: what changes is room to work in.
        """
        return None

    def restore(self, state: Any) -> None:
        """Take over what another instance's `state` gave."""

    def summary(self) -> Mapping[str, Any]:
        """Figures for the run's report, asked for once at the end.

        A sentence as `headline` tells the result: `fovea run` prints it among its first lines. A
        sentence as `incomplete` tells what could not be written: `fovea run` prints it, and its
        exit status is not zero. A source that has a rate tells it as `rate`, a mapping of
        `asked_hz` and `achieved_hz`: the run is judged by it.
        """
        return {}

    def headline(self) -> str:
        """A figure of now for the line that `fovea run` shows, a few words; asked every second.

        Called by another thread than the handlers: read, change nothing.
        """
        return ""

    @classmethod
    def advise(cls, settings: S, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Sentences for `fovea check` and `fovea run`: what these settings mean, warnings.

        No device is opened. `upstream` holds the settings of the node behind each connected input,
        by input name, and under `SOURCE` those of the node that makes frames. Raises `FoveaError`
        for what cannot work, such as weights that are not there.
        """
        return ()

    def loan(self, shape: tuple[int, ...], dtype: DTypeLike, output: str = "out") -> NDArray[Any]:
        """Memory of an output to write a big array into, so that sending it copies nothing."""
        return self._loan(output, shape, dtype)

    def allocate_from(self, memory: Loan) -> Loan:
        """Take the memory of outputs from here on from `memory`; returns what it came from before.

        For what runs the operator, between two calls of handlers.
        """
        before, self._loan = self._loan, memory
        return before


class Source(Operator[S, Out]):
    """An operator that makes frames instead of answering them: capture.

    `produce` and the handler of a command input are called by different threads. `realtime` is
    True when the source must keep its own rate, False in lockstep, where frame k+1 is asked for
    when the graph has answered frame k.
    """

    realtime: bool = True

    def produce(self) -> Mapping[str, Message] | None:
        """The next exposure, one message per output; None at the end of the stream.

        Raises `PoolExhausted` when a reader holds all the memory: the exposure is an overrun.
        """
        raise NotImplementedError


def inputs_of(operator: type[Operator[Any, Any]]) -> dict[str, Input]:
    """Declared inputs by name, base classes first, in the order they are written."""
    return _declared(operator, Input)


def outputs_of(operator: type[Operator[Any, Any]]) -> dict[str, type[Message]]:
    """Message type of each exit by name; empty for an operator that only consumes."""
    named = _declared(operator, Output)
    if named:
        return {name: output.message for name, output in named.items()}
    out = _parameter(operator, 1)
    return {"out": out} if isinstance(out, type) and issubclass(out, Message) else {}


def settings_of(operator: type[Operator[Any, Any]]) -> type[Any]:
    """The settings dataclass named in `Operator[Settings, Message]`."""
    settings = _parameter(operator, 0)
    if not isinstance(settings, type):
        raise SettingsError(
            f"{operator.__module__}:{operator.__qualname__}: expected Operator[Settings, Message] "
            "among its bases, got none"
        )
    return settings


def live_of(operator: type[Operator[Any, Any]]) -> tuple[str, ...]:
    """Its live settings; raises `SettingsError` when `live` names what is no setting."""
    known = {f.name for f in fields(settings_of(operator))}
    for name in operator.live:
        if name not in known:
            raise SettingsError(
                f"{operator.__module__}:{operator.__qualname__}.live: expected names of settings, "
                f"got {name!r}"
            )
    return tuple(operator.live)


def joined(operator: type[Operator[Any, Any]]) -> tuple[str, ...]:
    """Names of the inputs that arrive as one set; commands never do."""
    return tuple(n for n, i in inputs_of(operator).items() if i.join and not i.command)


def handler_of(operator: Operator[Any, Any], names: tuple[str, ...]) -> Callable[..., Any]:
    """The method `on_<first>_<second>…` for a set of inputs."""
    name = "on_" + "_".join(names)
    handler = getattr(operator, name, None)
    if not callable(handler):
        raise SettingsError(f"{type(operator).__qualname__}: no handler {name} for its inputs")
    return handler  # type: ignore[no-any-return]


D = TypeVar("D")


def _declared(operator: type[Any], kind: type[D]) -> dict[str, D]:
    found: dict[str, D] = {}
    for base in reversed(operator.__mro__):
        found.update({n: v for n, v in vars(base).items() if isinstance(v, kind)})
    return found


def _parameter(operator: type[Any], index: int) -> Any:
    for base in operator.__mro__:
        for generic in getattr(base, "__orig_bases__", ()):
            origin, arguments = get_origin(generic), get_args(generic)
            ours = isinstance(origin, type) and issubclass(origin, Operator)
            if ours and len(arguments) > index and not isinstance(arguments[index], TypeVar):
                return arguments[index]
    return None
