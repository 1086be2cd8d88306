"""Call the handlers of one operator and check what they return, for every runner.

A process, a shadow, the in-line runner and `pipeline.testing.drive` all call operators through
this module, so that a wrong return value gives the same error everywhere.
"""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pipeline import codec
from pipeline.contract import Loan, Operator, handler_of, joined, outputs_of
from pipeline.errors import MessageError, RunError, SettingsError
from pipeline.messages import Header, Message

Answers = Mapping[str, Message | None]  # by output; None or missing: no message for this exposure
M = TypeVar("M", bound=Message)


def open_operator(node: str, operator: Operator[Any, Any]) -> None:
    """Open an operator; its `SettingsError` begins with the node, whose name it does not know."""
    try:
        operator.open()
    except SettingsError as error:
        raise SettingsError(f"{node}: {error}") from error


class Executor:
    """Calls one operator. Errors begin with `node`; outputs are allocated from `memory`."""

    def __init__(
        self, node: str, operator: Operator[Any, Any], *, memory: Loan | None = None
    ) -> None:
        self._node, self._operator = node, operator
        if memory is not None:
            self.allocate_from(memory)
        self._outputs = outputs_of(type(operator))
        self._together = frozenset(joined(type(operator)))
        self._nothing: Answers = dict.fromkeys(self._outputs)
        self._handlers: dict[tuple[str, ...], Callable[..., Any]] = {}
        self._header: Header | None = None  # of the last exposure that was checked in full

    @property
    def operator(self) -> Operator[Any, Any]:
        """The operator that it calls."""
        return self._operator

    @property
    def single(self) -> bool:
        """Whether the operator has no named outputs."""
        return set(self._outputs) <= {"out"}

    def allocate_from(self, memory: Loan) -> Loan:
        """Allocate the memory of outputs from `memory` from now on; return the former allocator."""
        return self._operator.allocate_from(memory)

    def is_side(self, names: tuple[str, ...]) -> bool:
        """Whether these inputs are outside the joined set; their handler returns None."""
        return not self._together.issuperset(names)

    def call(self, messages: Mapping[str, Message | None]) -> Answers:
        """Call the handler of these inputs and return its messages by output.

        A handler outside the joined set has none. Raises `RunError` for a return value that does
        not fit the operator's outputs; exceptions of the operator pass through.
        """
        names = tuple(messages)
        handler = self._handlers.get(names) or self._find(names)
        given = handler(**messages)
        if self._together.issuperset(names):
            return self.answers(given)
        if given is not None:
            where = f"{self._node}.{handler.__name__}"
            raise RunError(f"{where}: expected no answer, got {_kind_of(given)}")
        return {}

    def produce(self) -> Answers | None:
        """Return a source's next exposure, None at its end; raises `RunError` as `call` does."""
        given: Any = self._operator.produce()  # type: ignore[attr-defined]
        if given is None:
            return None
        if type(given) is not dict and not isinstance(given, Mapping):
            raise RunError(
                f"{self._node}.produce: expected a mapping of outputs ({self._named()}) to "
                f"messages or None, got {_kind_of(given)}"
            )
        first: Header | None = None
        for output, message in given.items():
            if type(message) is not self._outputs.get(output):
                self._check_output(output, message)
                continue  # it is None
            header = message.header
            if first is None:
                first = header
                if not self._is_alike(header):
                    self._check_header(header)
            elif header is not first and exposure_of(header) != exposure_of(first):
                raise RunError(f"{self._node}.produce: expected one exposure, got several")
        if first is None:
            raise RunError(f"{self._node}.produce: expected a message or None, got no message")
        return given

    def answers(self, given: Any) -> Answers:
        """Return the return value of the joined set's handler by output; raises `RunError`."""
        if given is None:
            return self._nothing
        if type(given) is self._outputs.get("out"):
            return {"out": given}
        if isinstance(given, Message) and "out" in self._outputs:
            given = {"out": given}
        elif not isinstance(given, Mapping):
            expected = (
                f"a message per output ({self._named()}) or None" if self._outputs else "None"
            )
            raise RunError(f"{self._node}: expected {expected}, got {_kind_of(given)}")
        for output, message in given.items():
            if type(message) is not self._outputs.get(output):
                self._check_output(output, message)
        return given  # type: ignore[no-any-return]

    def _check_output(self, output: Any, message: Any) -> None:
        if output not in self._outputs:
            raise RunError(
                f"{self._node}: expected answers for its outputs ({self._named()}), got one "
                f"for {output!r}"
            )
        if message is not None:
            wanted = _article(self._outputs[output].__name__)
            raise RunError(
                f"{self._node}.{output}: expected {wanted} or None, got {_kind_of(message)}"
            )

    def _is_alike(self, header: Any) -> bool:
        """Whether a header is as valid as the last one: most differ in two numbers only."""
        before = self._header
        return (
            before is not None
            and type(header) is Header
            and type(header.seq) is int
            and type(header.stamp_ns) is int
            and header.stream is before.stream
            and header.clock is before.clock
            and header.geometry is before.geometry
            and header.trace is before.trace
        )

    def _check_header(self, header: Any) -> None:
        where = f"{self._node}.produce"
        if type(header) is not Header:
            raise RunError(f"{where}: expected a Header in each message, got {_kind_of(header)}")
        try:
            codec.pack(header)
        except MessageError as error:
            raise MessageError(f"{where}: {error}") from error
        self._header = header

    def _find(self, names: tuple[str, ...]) -> Callable[..., Any]:
        handler = handler_of(self._operator, names)
        try:
            known = inspect.signature(handler, follow_wrapped=False)
            known.bind(**dict.fromkeys(names))
        except ValueError:
            pass  # a function without an inspectable signature
        except TypeError as error:
            cls = type(self._operator).__qualname__
            raise SettingsError(
                f"{cls}.{handler.__name__}: expected the arguments {', '.join(names)}, got {error}"
            ) from error
        self._handlers[names] = handler
        return handler

    def _named(self) -> str:
        return ", ".join(self._outputs) or "none"


def header_of(answers: Answers) -> Header:
    """Return the header of an exposure from `Executor.produce`."""
    return next(m.header for m in answers.values() if m is not None)


def carried(message: M, where: str) -> M:
    """Return a message as its readers get it: checked, arrays read-only; raises `MessageError`."""
    try:
        return codec.carried(message)
    except MessageError as error:
        raise MessageError(f"{where}: {error}") from error


def exposure_of(header: Any) -> Any:
    """Return the key that identifies an exposure."""
    return (header.stream, header.seq) if type(header) is Header else header


def _kind_of(value: Any) -> str:
    return _article(type(value).__name__) if value is not None else "None"


def _article(name: str) -> str:
    """Return a name with its article.

    >>> _article("Frame"), _article("int")
    ('a Frame', 'an int')
    """
    return f"{'an' if name[:1].lower() in 'aeiou' else 'a'} {name}"
