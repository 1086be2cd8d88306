"""Call one operator by hand: messages in, its outputs out. For tests and notebooks."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pipeline.contract import Operator, inputs_of, joined, settings_of
from pipeline.declarations import check_declarations
from pipeline.errors import RunError
from pipeline.executor import Executor, carried, open_operator
from pipeline.messages import Geometry, Header, Message, altered
from pipeline.node.operator_state import check_state
from pipeline.settings import build, suggest


def header(seq: int = 0, *, stream: str = "test", geometry: Geometry | None = None) -> Header:
    """Return a header of a synthetic exposure; by default 1920x1080 pixels with a 480x270 ROI."""
    full_hd = Geometry(width_px=1920, height_px=1080, roi_width_px=480, roi_height_px=270)
    return Header(stream=stream, seq=seq, stamp_ns=seq * 33_333_333, geometry=geometry or full_hd)


def drive(
    operator: type[Operator[Any, Any]],
    messages: Iterable[Message | Mapping[str, Message]],
    settings: Mapping[str, Any] | None = None,
) -> list[Any]:
    """Open the operator, pass it each message (or each set by input name), and close it.

    A single message goes to the joined set; a mapping whose only key is an unjoined input goes
    to that input. Returns what each handler returned: a message, a mapping of named outputs to
    messages, or None.

    Raises `FoveaError` where a graph would: for wrong declarations, settings, messages or return
    values, and for a `state()` that no swap could carry over. As in a graph, the operator cannot
    write into the arrays it receives.
    """
    check_declarations(operator)
    name = operator.__qualname__
    subject = operator(build(settings_of(operator), settings or {}, name))
    executor = Executor(name, subject)
    answers: list[Any] = []
    stream = ""
    try:
        open_operator(name, subject)
        for message in messages:
            arguments = _arguments(operator, message)
            seen = next(m for m in arguments.values() if m is not None).header
            if seen.stream != stream:
                subject.on_stream(seen)
                stream = seen.stream
            answers.append(_checked(executor, arguments, name))
        check_state(name, subject)
    finally:
        subject.close()
    return answers


def _arguments(operator: type[Operator[Any, Any]], given: Any) -> dict[str, Message | None]:
    """Return the arguments of one handler; raises `RunError` or `MessageError`."""
    name, together = operator.__qualname__, joined(operator)
    if isinstance(given, Message) and together:
        given = {together[0]: given}
    if not isinstance(given, Mapping) or not given:
        expected = "a message or a mapping" if together else "a mapping"
        raise RunError(
            f"{name}: expected {expected} of inputs to messages, got {type(given).__name__}"
        )
    inputs = inputs_of(operator)
    received: dict[str, Message | None] = {}
    for key, message in given.items():
        if key not in inputs:
            raise RunError(f"{name}: no input {key}{suggest(str(key), inputs)}")
        wanted = inputs[key].message
        if type(message) is not wanted and not (message is None and inputs[key].optional):
            got = type(message).__name__
            raise RunError(f"{name}.{key}: expected a {wanted.__name__}, got {got}")
        if message is not None:
            received[key] = carried(message, f"{name}.{key}")
    if not received:
        raise RunError(f"{name}: expected at least one message in a mapping, got none")
    if not set(given) & set(together):
        return received
    for key in (*together, *received):
        if key not in together:
            raise RunError(f"{name}.{key}: expected it in a mapping of its own, got it in a set")
        if key not in received and not inputs[key].optional:
            raise RunError(f"{name}.{key}: expected a {inputs[key].message.__name__}, got none")
    return {key: received.get(key) for key in together}


def _checked(executor: Executor, arguments: dict[str, Message | None], name: str) -> Any:
    """Call the operator and return its outputs after the checks that a graph makes."""
    given = {output: m for output, m in executor.call(arguments).items() if m is not None}
    head = next(m for m in arguments.values() if m is not None).header
    for output, message in given.items():
        carried(altered(message, header=head), f"{name}.{output}")
    return given.get("out") if executor.single else given or None


def picture(height_px: int, width_px: int, *, seed: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return a random RGB picture, (h, w, 3) uint8."""
    return np.random.default_rng(seed).integers(0, 256, (height_px, width_px, 3), np.uint8)
