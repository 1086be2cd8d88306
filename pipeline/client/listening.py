"""Messages, rate, jitter and age of an output of a running graph, measured by a tap.

The output needs no other reader, and a tap cannot slow the graph down. It counts missed messages by
reason, so that the figures are those of the output, not of the tap.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from pipeline.bus.tap import Heard, Missed
from pipeline.client.described import Described
from pipeline.client.graph_client import Listener
from pipeline.errors import RunError

QUIET_S = 10.0  # without a message for this long, echo ends with an error
LOOK_S = 0.5  # without one for this long, check whether the graph still runs
SILENT_S = 0.5  # hz reports silence after this time, if it is long for the output
SILENT_GAPS = 3
Item = Described | Missed | str  # a message, a loss before it, or why no more will come


class Rate(msgspec.Struct, kw_only=True):
    """Figures of an output over some seconds; without two messages, no interval figures."""

    output: str
    messages: int
    nothings: int = 0  # exposures without a message
    missed: dict[str, int] = {}  # by reason
    instances: int = 1
    rate_hz: float | None = None
    gap_ms: dict[str, float] | None = None  # shortest, longest, std; gaps with a loss excluded
    age_ms_p50: float | None = None
    silent_s: float = 0.0  # time since the last message, if long
    over: str = ""  # why the measurement ended early


def echo(listener: Listener, count: int) -> Iterator[Item]:
    """Yield every message of an output, and a notice wherever some were missed.

    Ends with the graph; raises `RunError` if that is before `count`, or after a long silence.
    """
    told, heard_s, nothings, messages = Missed(), time.monotonic(), 0, 0
    output = listener.output
    with listener:
        tap = listener.tap
        while not count or messages < count:
            heard, missed = tap.next(LOOK_S), tap.missed
            if missed != told:
                yield missed.since(told)
                told = missed
            if heard is not None and heard.message is not None:
                messages, heard_s, nothings = messages + 1, time.monotonic(), 0
                yield heard.message
                continue
            nothings += heard is not None
            if time.monotonic() - heard_s > QUIET_S:
                raise RunError(f"{output}: no message for {QUIET_S:.0f} s{_times(nothings)}")
            if heard is None and (over := listener.over()):
                if count:
                    raise RunError(f"{over} after {messages} of {count} messages of {output}")
                yield over
                return


def rate(listener: Listener, duration_s: float) -> Rate:
    """Measure rate, jitter and age for some seconds; raises `RunError` without any message."""
    heard: list[Heard] = []
    end_s, over = time.monotonic() + duration_s, ""
    with listener:
        tap = listener.tap
        while not over and (left_s := end_s - time.monotonic()) > 0:
            one = tap.next(min(left_s, LOOK_S))
            if one is not None:
                heard.append(one)
            else:
                over = listener.over()
        found = figures(listener.output, heard, tap.missed, time.monotonic_ns(), duration_s)
        ages = [age for one in heard if one.message and (age := listener.age_ns(one)) is not None]
        found.age_ms_p50 = float(np.median(ages)) / 1e6 if ages else None
        found.instances, found.over = tap.instances, over
    return found


def figures(
    output: str, heard: Sequence[Heard], missed: Missed, now_ns: int, duration_s: float
) -> Rate:
    """Return the figures so far; raises `RunError` without any message."""
    messages = [one for one in heard if one.message is not None]
    nothings = len(heard) - len(messages)
    if not messages:
        words = _times(nothings) + (f"; {missed}" if sum(missed) else "")
        raise RunError(f"{output}: no message in {duration_s:.1f} s{words}")
    found = Rate(
        output=output, messages=len(messages), nothings=nothings,
        missed={name: n for name, n in missed._asdict().items() if n},
    )  # fmt: skip
    if len(messages) < 2:
        return found
    stamps = np.array([one.at_ns for one in messages], np.int64)
    gaps = np.diff(stamps) / 1e6
    whole = gaps[[not one.after_loss for one in messages[1:]]]
    silent_s = float(now_ns - stamps[-1]) / 1e9
    span_s, sent = float(stamps[-1] - stamps[0]) / 1e9, len(messages) + sum(missed) - 1
    if silent_s > max(SILENT_S, SILENT_GAPS * gaps.max() / 1e3):
        span_s, sent, found.silent_s = span_s + silent_s, sent + 1, silent_s
    found.rate_hz = sent / span_s
    if len(whole):
        found.gap_ms = {
            "shortest": float(whole.min()), "longest": float(whole.max()), "std": float(whole.std())
        }  # fmt: skip
    return found


def rate_line(found: Rate, duration_s: float) -> str:
    """Return the figures as one line."""
    extra = _times(found.nothings)
    if found.missed:
        extra += f"; {Missed(**found.missed)}"
    if found.instances > 1:
        extra += f"; {found.instances - 1} times another instance took over"
    if found.over:
        extra += f"; {found.over}"
    if found.rate_hz is None:
        return f"{found.output}: fewer than two messages in {duration_s:.1f} s{extra}"
    if found.silent_s:
        extra = f", none in the last {found.silent_s:.1f} s{extra}"
    gap = found.gap_ms
    jitter = (
        f"gap {gap['shortest']:.1f} .. {gap['longest']:.1f} ms (std {gap['std']:.2f})"
        if gap
        else "no two messages in a row"
    )
    age = "not known" if found.age_ms_p50 is None else f"{found.age_ms_p50:.1f} ms p50"
    return (
        f"{found.output}: {found.rate_hz:.2f} Hz, {jitter}, age {age}, "
        f"{found.messages} messages{extra}"
    )


def plain(item: Item) -> dict[str, Any]:
    """Return an item as one JSON object; large arrays by type and shape."""
    if isinstance(item, str):
        return {"over": item}
    if isinstance(item, Missed):
        return {"missed": {name: n for name, n in item._asdict().items() if n}}
    return {"seq": item.header.seq, **{name: _plain(v) for name, v in item.values.items()}}


def line(item: Item) -> str:
    """Return an item as one line: small values as they are, arrays by shape."""
    if not isinstance(item, Described):
        return str(item)
    parts = [f"seq {item.header.seq}"]
    for name, value in item.values.items():
        if isinstance(value, np.ndarray):
            small = np.array2string(value, precision=1, separator=",").replace("\n", "")
            text = small if value.size <= SMALL else f"{value.dtype}{list(value.shape)}"
        else:
            text = str(_plain(value))
        parts.append(f"{name} {text}")
    return "  ".join(parts)


SMALL = 8  # items of an array that is shown in full


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        if value.size <= SMALL:
            return value.tolist()
        return {"dtype": str(value.dtype), "shape": list(value.shape)}
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list) else value


def _times(nothings: int) -> str:
    return f", {nothings} times nothing" if nothings else ""
