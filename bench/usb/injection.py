"""One failure of the link, from the first frame until frames come again: what became of each."""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from logging import WARNING, Handler, LogRecord, getLogger
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from bench.usb.failing import WitnessedDriver, level_of
from bench.usb.reasons import Loss, explained
from drivers.sensor import Exposure
from drivers.usb import DualStreamBoardSettings
from pipeline.errors import DriverError

BACKEND = "bench.usb.failing:WitnessedBackend"
SIZE_PX = (320, 192)
AFTER = 5  # exposures that have to come after a failure
LIMIT_S = 20.0  # of one injection
LINK = ("outages", "stalls", "resets", "silences")


@dataclass(frozen=True, kw_only=True)
class Injection:
    """What happened around one failure. Times are since the failure, -1: it did not come to that.

    `exposed` counts what the board exposed, `lost` those that did not arrive, by the reason that
    the driver counted; `unexplained` are lost without one. `never_exposed` are numbers that were
    passed over while the board was silent or away.
    """

    exposed: int
    delivered: int
    lost: Mapping[str, int]
    unexplained: int
    never_exposed: int
    wrong: int  # delivered with other pixels than the board sent
    events: Mapping[str, int]
    sentences: Sequence[str]
    error: str
    said_ms: float
    recovered_ms: float  # from the failure's end, where it lasts


@dataclass
class _Ledger:
    """The account of exposures, kept while they are read."""

    lost: Counter[str] = field(default_factory=Counter)
    unexplained: int = 0
    numbers: int = 0  # of exposures, up to the last that was delivered
    delivered: int = 0
    wrong: int = 0


def injected(
    faults: Sequence[Mapping[str, Any]], *, rate_hz: float, lasting_s: float = 0.0,
    pause_s: float = 0.0, pause_at: int = -1,
) -> Injection:  # fmt: skip
    """Open a board, let it fail, read until it has recovered or the driver ends with an error.

    `lasting_s` is how long the failure goes on by itself. Instead of a failure of the board, the
    reader can pause for `pause_s` after the exposure `pause_at`.
    """
    subject = WitnessedDriver(DualStreamBoardSettings(
        rate_hz=rate_hz, payload_crc=True, backend=BACKEND,
        backend_options={
            "profile": "ideal", "scene": "soccer", "size_px": SIZE_PX, "faults": list(faults),
        },
    ))  # fmt: skip
    with _listening() as heard:
        try:
            subject.open(realtime=True)
            subject.start()
            return _read(subject, heard, lasting_s, pause_s, pause_at)
        finally:
            subject.close()


def _read(
    subject: WitnessedDriver, heard: list[tuple[float, str]], lasting_s: float, pause_s: float,
    pause_at: int,
) -> Injection:  # fmt: skip
    ledger, board, error, recovered_s, after = _Ledger(), subject.board, "", -1.0, 0
    last: tuple[int, int] = (0, -1)  # START, exposure
    before, paused_s, begun, noted = subject.summary(), -1.0, None, 0
    deadline_s = time.monotonic() + LIMIT_S
    while after < AFTER and time.monotonic() < deadline_s:
        try:
            found = subject.read(_memory)
        except DriverError as failure:
            error = str(failure)
            heard.append((time.monotonic(), error))
            break
        if found is None:
            break
        now_s, told = time.monotonic(), subject.summary()
        here = len(board.exposed) - 1, found.header.seq - subject.first_seq
        missing = exposures_between(board.exposed, last, here)
        _account(ledger, missing, subject.noted[noted:], before, told)
        noted = len(subject.noted)
        ledger.numbers = found.header.seq + 1
        _check(ledger, found, here[1])
        last, before, known = here, told, begun
        begun = _begun(board.script.times, paused_s, pause_at)
        if begun != known:  # another one
            after, recovered_s = 0, -1.0
        if begun is not None and (here[0] or here[1] > begun[1]):
            recovered_s = now_s if not after else recovered_s
            after += 1
        if here[1] >= pause_at >= 0 > paused_s:
            paused_s = time.monotonic()
            time.sleep(pause_s)
    begun = _begun(board.script.times, paused_s, pause_at)
    return _closed(
        subject, ledger, last, heard, error,
        since_s=begun[0] if begun else -1.0, lasting_s=lasting_s or pause_s,
        recovered_s=recovered_s,
    )  # fmt: skip


def _begun(
    times: Sequence[tuple[float, int]], paused_s: float, pause_at: int
) -> tuple[float, int] | None:
    """Return when the (last) failure began, and after which exposure."""
    if paused_s >= 0:
        return paused_s, pause_at
    return times[-1] if times else None


def _account(
    ledger: _Ledger, missing: Sequence[int], losses: Sequence[Loss], before: Mapping[str, Any],
    told: Mapping[str, Any],
) -> None:  # fmt: skip
    """Put what was lost between two deliveries down to what the driver counted meanwhile."""
    stalls = told["losses"].get("stall", 0) - before["losses"].get("stall", 0)
    outage = told["link"]["outages"] > before["link"]["outages"]
    shares = explained(missing, losses, stalls=stalls, outage=outage)
    ledger.lost.update(shares)
    ledger.unexplained += len(missing) - sum(shares.values())
    ledger.delivered += 1


def exposures_between(
    exposed: Sequence[set[int]], last: tuple[int, int], here: tuple[int, int]
) -> list[int]:
    """Return the exposures between two (START, exposure), both exclusive.

    >>> exposures_between([{0, 1, 2}, {0, 1}], (0, 1), (1, 1))
    [2, 0]
    """
    return [
        exposure
        for start in range(last[0], here[0] + 1)
        for exposure in sorted(exposed[start])
        if last < (start, exposure) < here
    ]


def _check(ledger: _Ledger, found: Exposure, exposure: int) -> None:
    level = level_of(exposure)
    sound = all((frame.pixels == level).all() for frame in (found.context, found.roi))
    ledger.wrong += not sound


def _closed(
    subject: WitnessedDriver, ledger: _Ledger, last: tuple[int, int],
    heard: Sequence[tuple[float, str]], error: str, *, since_s: float, lasting_s: float,
    recovered_s: float,
) -> Injection:  # fmt: skip
    """Close the account: what was exposed up to the last delivery has arrived or is lost."""
    exposed = subject.board.exposed
    total = len(exposures_between(exposed, (0, -1), (last[0], last[1] + 1)))
    told = subject.summary()
    events = {name: told["link"][name] for name in LINK if told["link"][name]}
    events |= {f"lost, {name}": count for name, count in told["losses"].items()}
    said = [at_s for at_s, _ in heard if at_s >= since_s]
    happened = since_s >= 0
    return Injection(
        exposed=total, delivered=ledger.delivered, lost=dict(ledger.lost),
        unexplained=ledger.unexplained, never_exposed=max(0, ledger.numbers - total),
        wrong=ledger.wrong,
        events=events, sentences=[text for _, text in heard], error=error,
        said_ms=1e3 * (min(said) - since_s) if said and happened else -1.0,
        recovered_ms=1e3 * (recovered_s - since_s - lasting_s)
        if recovered_s >= 0 and happened else -1.0,
    )  # fmt: skip


@contextmanager
def _listening() -> Iterator[list[tuple[float, str]]]:
    """Collect what the driver says in this thread."""
    heard: list[tuple[float, str]] = []
    logger, mine = getLogger("drivers.usb"), threading.get_ident()

    class Ear(Handler):
        def emit(self, record: LogRecord) -> None:
            if record.thread == mine:
                heard.append((time.monotonic(), record.getMessage()))

    ear = Ear(WARNING)
    logger.addHandler(ear)
    try:
        yield heard
    finally:
        logger.removeHandler(ear)


def _memory(
    _output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
) -> NDArray[Any]:
    return np.empty(shape, dtype)
