"""The contract of an operator: settings and messages in, messages out.

An operator is a class with frozen settings, inputs declared as class attributes, and one handler
per input (`on_<input>`) or per joined set of inputs (`on_<first>_<second>`). It runs as a process
of its own, with others in one process or in the in-line runner; its code is the same in all three.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import SettingsError
from pipeline.forecast import Forecast, Upstream
from pipeline.messages import Header, Message

S = TypeVar("S")
Out = TypeVar("Out")
SOURCE = "@source"  # a key beside the names of inputs, see `Operator.advise`
BEFORE = "@before"  # another one
Keep = Literal["latest", "every"]
INCOMPLETE = "incomplete"  # key of a summary: a sentence on what could not be written
HEADLINE = "headline"  # key of a summary: the result of the run, as a sentence
RATE = "rate"  # key of a source's summary: asked_hz and achieved_hz of its frames


class Loan(Protocol):
    """Returns memory of an output for an array of a shape and type; see `Operator.loan`."""

    def __call__(
        self, output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        """Raises `PoolExhausted` when all of it is in use."""
        ...


@dataclass(frozen=True)
class Input:
    """One typed input of an operator.

    By default, the inputs of an operator are joined: they wait for one another and arrive as a
    set with equal `seq`. A `join=False` input has a handler of its own, `on_<input>`, which
    returns None; in lockstep it runs after the set of the same frame.
    """

    message: type[Message]
    keep: Keep = "latest"  # latest: drop and count older ones; every: lossless, the writer waits
    depth: int = 8  # capacity of the queue in frames, and of the join table in sets
    join: bool = True
    optional: bool = False  # the handler gets None where it is missing
    wait_ms: float = 0.0  # realtime: how long a complete set waits for its optional members
    max_age_ms: float = 0.0  # stale when older than this since its stamp; 0: never; not in lockstep
    stale: Literal["drop", "pass"] = "drop"  # drop and count it, or pass it on uncounted
    command: bool = False  # a sensor command: closes the loop, only the newest is kept
    # a viewer: its messages are copied, so that it pins no memory; in real time no writer waits
    # for it: with keep="every" the oldest are dropped when more than `depth` wait
    tap: bool = False


@dataclass(frozen=True)
class Output:
    """A named output; an operator that declares none has a single one called `out`."""

    message: type[Message]


def fresh_memory(
    _output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
) -> NDArray[Any]:
    """Return new memory that no reader shares."""
    return np.empty(shape, dtype)


class Operator(Generic[S, Out]):
    """A node of a graph. `Out` is the message type that its handlers return (None: no output).

    `__init__` only stores; `open` acquires resources, in the process that uses them; `close`
    releases them after any outcome. With named outputs, handlers return a mapping of output name
    to message.

    `live` lists the settings that may change while it runs (`fovea set`), `commands` the methods
    `do_<command>` that may be called from outside (`fovea tell`).
    """

    live: ClassVar[tuple[str, ...]] = ()
    commands: ClassVar[tuple[str, ...]] = ()

    def __init__(self, settings: S, *, loan: Loan | None = None) -> None:
        self.settings = settings
        self._loan = loan or fresh_memory

    def open(self) -> None:
        """Acquire what the handlers need: models, files, devices."""

    def close(self) -> None:
        """Release everything; called after any outcome, even when `open` failed."""

    def on_stream(self, header: Header) -> None:
        """Forget the state of the old stream; called when a sensor was opened anew."""

    def on_settings(self, settings: S) -> None:
        """Apply settings of which only `live` ones differ; called between two calls of handlers.

        Types and ranges are already checked. Raise `SettingsError` to refuse the settings, and
        leave everything as it was. For a `Source` it is called between two exposures.
        """
        self.settings = settings

    def state(self) -> object | None:
        """Return what must survive a swap, as one dataclass of plain values and arrays.

        Its return annotation has to name the dataclass: without it no swap carries the state over.
        An override that returns None declares that nothing must: what changes is scratch memory.
        """
        return None

    def restore(self, state: Any) -> None:
        """Take over what `state` of another instance returned."""

    def summary(self) -> Mapping[str, Any]:
        """Return figures for the report of the run; called once, at the end.

        A sentence as `headline` tells the result: `fovea run` prints it among its first lines. A
        sentence as `incomplete` tells what could not be written: `fovea run` prints it, and its
        exit status is not zero. A source that has a rate tells it as `rate`, a mapping of
        `asked_hz` and `achieved_hz`: the run is judged by it.
        """
        return {}

    def headline(self) -> str:
        """Return a few words with a current figure for the status line of `fovea run`.

        Called every second, by another thread than the handlers: read state, never change it.
        """
        return ""

    def runs_on(self) -> str:
        """Return the providers that compute its networks, such as `cpu`; empty without a network.

        Called every second after `open`, as `headline`; `fovea top` and the report show it.
        """
        return ""

    @classmethod
    def advise(cls, settings: S, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Return sentences for `fovea check` and `fovea run`: effects of these settings, warnings.

        Open no device. `upstream` holds the settings of the node that feeds each connected input,
        by input name; under `SOURCE` those of the source, and under `BEFORE` a tuple of those of
        all nodes that this one depends on, nearest first. Raises `FoveaError` for settings that
        cannot work, such as missing weights.
        """
        return ()

    @classmethod
    def forecast(cls, settings: S, upstream: Upstream) -> Forecast:
        """Return what it will send with these settings, for the tables of `fovea check`.

        An override opens no device unless `upstream.ask`, and states only what is certain. Raises
        `FoveaError` for settings that cannot work.
        """
        return Forecast()

    def loan(
        self, shape: tuple[int, ...], dtype: DTypeLike, output: str = "out", *, ahead: bool = False
    ) -> NDArray[Any]:
        """Return memory of an output; an array written there is sent without a copy.

        It may be written until the handler returns; with `ahead` until a message with it is sent,
        in this call or a later one. At most two arrays of an output are lent ahead; a third loan
        raises `PoolExhausted`. What is kept longer may be overwritten by any later message.
        """
        return self._loan(output, shape, dtype, ahead=ahead)

    def allocate_from(self, memory: Loan) -> Loan:
        """Allocate the memory of outputs from `memory` from now on; return the former allocator.

        For the runtime, between two calls of handlers.
        """
        before, self._loan = self._loan, memory
        return before


class Source(Operator[S, Out]):
    """An operator that produces frames, such as a sensor.

    `produce` and the handler of a command input are called by different threads. `realtime` is
    True when the source must keep its own rate, and False in lockstep, where frame k+1 is
    requested once the graph has finished frame k.
    """

    realtime: bool = True

    @property
    def absent_until_s(self) -> float:
        """Until when it waits for a device that was lost, in `time.monotonic()`; 0: none is lost.

        Until then a `produce` that does not return is no stall, for a day at most; afterwards the
        `stall_s` of the node counts anew. Read every second by another thread.
        """
        return 0.0

    def produce(self) -> Mapping[str, Message] | None:
        """Return the next exposure, one message per output; None at the end of the stream.

        Raises `PoolExhausted` when readers hold all the memory: the exposure counts as an overrun.
        """
        raise NotImplementedError


def inputs_of(operator: type[Operator[Any, Any]]) -> dict[str, Input]:
    """Return declared inputs by name, base classes first, in the order of their declaration."""
    return _declared(operator, Input)


def outputs_of(operator: type[Operator[Any, Any]]) -> dict[str, type[Message]]:
    """Return the message type of each output by name; empty for an operator that only consumes."""
    named = _declared(operator, Output)
    if named:
        return {name: output.message for name, output in named.items()}
    out = _parameter(operator, 1)
    return {"out": out} if isinstance(out, type) and issubclass(out, Message) else {}


def settings_of(operator: type[Operator[Any, Any]]) -> type[Any]:
    """Return the settings dataclass named in `Operator[Settings, Message]`."""
    settings = _parameter(operator, 0)
    if not isinstance(settings, type):
        raise SettingsError(
            f"{operator.__module__}:{operator.__qualname__}: expected Operator[Settings, Message] "
            "among its bases, got none"
        )
    return settings


def live_of(operator: type[Operator[Any, Any]]) -> tuple[str, ...]:
    """Return its live settings; raises `SettingsError` when `live` names an unknown setting."""
    known = {f.name for f in fields(settings_of(operator))}
    for name in operator.live:
        if name not in known:
            raise SettingsError(
                f"{operator.__module__}:{operator.__qualname__}.live: expected names of settings, "
                f"got {name!r}"
            )
    return tuple(operator.live)


def joined(operator: type[Operator[Any, Any]]) -> tuple[str, ...]:
    """Return the names of the inputs that arrive as one set; command inputs never do."""
    return tuple(n for n, i in inputs_of(operator).items() if i.join and not i.command)


def handlers_of(operator: type[Operator[Any, Any]]) -> dict[str, tuple[str, ...]]:
    """Return the inputs of each handler, by its name: the joined set, and each other input."""
    inputs = inputs_of(operator)
    groups: list[tuple[str, ...]] = [
        (name,) for name, port in inputs.items() if port.command or not port.join
    ]
    if together := joined(operator):
        groups.append(together)
    return {f"on_{'_'.join(names)}": names for names in groups}


def handler_of(operator: Operator[Any, Any], names: tuple[str, ...]) -> Callable[..., Any]:
    """Return the method `on_<first>_<second>…` for a set of inputs."""
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
