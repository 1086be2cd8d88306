"""What was found, as text: sensors and kinds in, lines out."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from drivers.attached.listing import AttachedSensor, KindFound, Offer

ADDRESS = re.compile(r"\b([a-z][a-z0-9+.-]*://)(\S+)", re.IGNORECASE)
QUERY = re.compile(r"\?.*?([:;,.]?)$")  # and the mark behind it that belongs to the sentence
MOST_OFFERS = 12  # lines of one sensor; `--json` has all of them
NOTHING = "no sensor is attached; `fovea sensors test virtual` tries the checks without one"


def listing(found: Sequence[KindFound]) -> Iterator[str]:
    """Yield the lines of a list: sensors first, then what was not looked for."""
    sensors = [sensor for kind in found for sensor in kind.sensors]
    for sensor in sensors:
        yield from described(sensor)
        yield ""
    if not sensors:
        yield NOTHING
    for kind in found:
        if kind.missing:
            yield f"not looked for: {kind.what}: {kind.missing}"
        if kind.problem:
            yield f"not found out: {kind.what}: {kind.problem}"


def described(sensor: AttachedSensor) -> Iterator[str]:
    """Yield the lines of one sensor; those that it does not tell are left out."""
    yield f"{sensor.name}  {sensor.title}" + (f" ({sensor.where})" if sensor.where else "")
    if sensor.problem:
        yield _row("problem", sensor.problem + (f" -> {sensor.remedy}" if sensor.remedy else ""))
    offers = _merged(sensor.offers)
    for offer in offers[:MOST_OFFERS]:
        yield _row("sends", offer)
    if len(offers) > MOST_OFFERS:
        yield _row("", f"and {len(offers) - MOST_OFFERS} more, see --json")
    if any(sensor.context_px):
        yield _row("context", _by(sensor.context_px))
    if sensor.roi_sizes_px:
        yield _row("ROI", ", ".join(map(_by, sensor.roi_sizes_px[:8])))
    if sensor.modes:
        yield _row("modes", ", ".join(sensor.modes))
    if sensor.foveation:
        yield _row("foveates", ("yes: " if sensor.foveates else "no: ") + sensor.foveation)
    if sensor.run:
        yield _row("run", sensor.run)


def figures_line(figures: Mapping[str, Any]) -> str:
    """Return figures on one line.

    >>> figures_line({"asked_hz": 30.0, "field_px": [1920, 1080], "same_exposure": True})
    'asked_hz 30, field_px 1920x1080, same_exposure yes'
    """
    return ", ".join(f"{name} {_value(name, value)}" for name, value in figures.items())


def shown_address(text: str) -> str:
    """Return a text with user, password and query of URLs left out.

    >>> shown_address("rtsp://me:secret@camera.local/one?pwd=secret: no answer")
    'rtsp://camera.local/one?…: no answer'
    """
    return ADDRESS.sub(lambda url: url[1] + QUERY.sub(r"?…\1", url[2].rpartition("@")[2]), text)


def without_credentials(value: Any, name: str = "") -> Any:
    """Return plain values, the setting of this name, with URLs and pipelines as they are shown."""
    if isinstance(value, Mapping):
        return {key: without_credentials(item, key) for key, item in value.items()}
    if isinstance(value, list):
        return [without_credentials(item) for item in value]
    if isinstance(value, str) and name == "pipeline":
        from drivers.cameras.address import pipeline_shown  # its package brings OpenCV

        return pipeline_shown(value)
    return shown_address(value) if isinstance(value, str) else value


def _value(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        joint = {"px": "x", "hz": " to "}.get(name.rpartition("_")[2], " ")
        return joint.join(_value("", one) for one in value)
    return str(value)


def _merged(offers: Sequence[Offer]) -> list[str]:
    """Lines of offers: formats that share sizes and rates are on one."""
    formats: dict[tuple[str, str], list[str]] = {}
    for offer in offers:
        what = _by(offer.size_px) if any(offer.size_px) else "", _rates(offer)
        formats.setdefault(what, []).append(offer.pixel_format)
    return [
        " ".join(filter(None, (size, rates and f"at {rates}", "as", ", ".join(names))))
        for (size, rates), names in formats.items()
    ]


def _rates(offer: Offer) -> str:
    if not offer.rates_hz:
        return ""
    joint = " to " if offer.ranged else ", "
    return joint.join(f"{rate:g}" for rate in offer.rates_hz) + " Hz"


def _by(size_px: Sequence[int]) -> str:
    return "x".join(str(side) for side in size_px)


def _row(what: str, text: str) -> str:
    return f"  {what:<9} {text}"
