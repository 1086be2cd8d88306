"""The checks of `fovea sensors test`, one after the other: a name in, a verdict for each out.

It runs in a child process, since a driver's library may crash or never return.
"""

import json
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from typing import Any, Literal

from drivers.attached.measurement import Run, accounts, effect, rate, run_in_real_time
from drivers.attached.recording import MODE, RECORDING
from drivers.attached.subject import subject_of
from drivers.contract import CHECKS, SKIPPED, Figures, Make, title
from pipeline.errors import FoveaError
from pipeline.text import error_text, harmless, said_by

Verdict = Literal["ok", "wrong", "skipped"]
OPENS, REAL_TIME = "it opens", "it runs in real time"
MEASURED: Mapping[str, Callable[[Run], Figures]] = {
    "the rate is kept": rate,
    "commands take effect": effect,
    "every frame is accounted for": accounts,
}
TITLES = (OPENS, *map(title, CHECKS), REAL_TIME, *MEASURED)


def tried(name: str, changes: str, duration_s: str) -> Iterator[dict[str, Any]]:
    """Yield the sensor, then each check: as it begins, and with its verdict.

    `changes` is a JSON list of `OPTION=VALUE`. A sensor that cannot be opened is asked no more, one
    in the mode `record` what holds for recording.
    Raises `FoveaError` for a name or settings that are none.
    """
    with subject_of(name, json.loads(changes)) as subject:
        subject.make()
        yield {"sensor": subject.sensor, "options": subject.options}
        opened = yield from _checked(OPENS, partial(opens, subject.make))
        if opened["verdict"] != "ok":
            return
        records = subject.options.get("mode") == MODE
        for check in RECORDING if records else CHECKS:
            yield from _checked(title(check), partial(check, subject.make))
        if records:
            return  # it has no rate of delivery, and its commands are plans
        runs: list[Run] = []

        def run() -> Figures:
            runs.append(run_in_real_time(subject.make, float(duration_s)))
            return {"frames": len(runs[0].seqs)}

        yield from _checked(REAL_TIME, run)
        for what, measure in MEASURED.items():
            if runs:
                yield from _checked(what, partial(measure, runs[0]))


def opens(make: Make) -> Figures:
    """Open the sensor once; return what it can do."""
    sensor = make()
    try:
        sensor.open(realtime=False)
        can = sensor.capabilities()
    finally:
        sensor.close()
    grid = can.geometry
    return {
        "field_px": (grid.width_px, grid.height_px),
        "context_px": can.context_px,
        "roi_px": (grid.roi_width_px, grid.roi_height_px),
        "rates_hz": can.rates_hz,
        "pixel_formats": can.pixel_formats[:8],
        "same_exposure": can.same_exposure,
    }


def _checked(
    what: str, check: Callable[[], Figures]
) -> Generator[dict[str, Any], None, dict[str, Any]]:
    """Yield that a check begins and then its result, which is also returned."""
    yield {"begins": what}
    began_s = time.monotonic()
    verdict, why, figures = _result(check)
    seconds = round(time.monotonic() - began_s, 3)
    found = {
        "check": what, "verdict": verdict, "why": why, "figures": figures, "seconds": seconds,
    }  # fmt: skip
    yield found
    return found


def _result(check: Callable[[], Figures]) -> tuple[Verdict, str, dict[str, Any]]:
    try:
        figures = dict(check())
    except FoveaError as error:
        return "wrong", harmless(said_by(error)), {}
    except Exception as error:  # of a driver with a mistake
        return "wrong", harmless(error_text(error)), {}
    if reason := figures.pop(SKIPPED, ""):
        return "skipped", str(reason), figures
    return "ok", "", figures
