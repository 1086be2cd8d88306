"""Whether what a sensor sends fits its link: a forecast in, figures and verdicts out."""

from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.forecast import Forecast, LinkUse, PictureStream
from pipeline.planner.links import LINKS, Verdict
from pipeline.planner.rates import below


@dataclass(frozen=True, kw_only=True)
class LinkPlan:
    """The need of one source, in bytes a second, and what each kind of link makes of it."""

    node: str
    streams: str  # in words
    crosses: bool  # False: no link is stated; figures as if its outputs crossed one
    needed_bytes_per_s: float | None  # None: not known
    frame_bytes: int | None  # of all streams, where they have one rate
    kind: str  # of the link in use; empty: not known
    stated_bytes_per_s: float  # what the device carries by its own statement; 0: it states none
    verdicts: dict[str, Verdict]  # by key of `LINKS`


def link_plan(node: str, told: Forecast, wanted: str = "") -> LinkPlan | None:
    """Return the figures of a source; None where it states no streams. `wanted` is a `LINKS` key.

    A source that states no link, as a simulated sensor, is judged by the streams that it outputs.
    """
    use = told.link or LinkUse(streams=tuple(told.streams.values()))
    if not use.streams:
        return None
    needs = [stream.bytes_per_s for stream in use.streams]
    needed = None if None in needs else sum(need for need in needs if need is not None)
    sizes = [stream.frame_bytes for stream in use.streams]
    together = None not in sizes and len({stream.rate_hz for stream in use.streams}) == 1
    return LinkPlan(
        node=node,
        streams=" + ".join(map(in_words, use.streams)),
        crosses=told.link is not None,
        needed_bytes_per_s=needed,
        frame_bytes=sum(size or 0 for size in sizes) if together else None,
        kind=wanted or use.kind,
        stated_bytes_per_s=use.carries_bytes_per_s,
        verdicts={key: link.verdict(needed) for key, link in LINKS.items()},
    )


def in_words(stream: PictureStream) -> str:
    """Return a stream as a sentence names it.

    >>> in_words(PictureStream(size_px=(640, 480), pixel_format="rgb8", frame_bytes=None))
    '640x480 rgb8'
    """
    width, height = stream.size_px
    rate = f" at {stream.rate_hz:.4g} Hz" if stream.rate_hz else ""
    return f"{width}x{height} {stream.pixel_format}{rate}"


def refused(found: LinkPlan) -> Iterator[str]:
    """Yield a sentence for each limit of the link that the streams exceed."""
    if found.needed_bytes_per_s is None:
        return
    limits = [(found.stated_bytes_per_s, "the device's link")] if found.stated_bytes_per_s else []
    if found.kind and found.verdicts.get(found.kind) == "does not fit":
        limits.append((LINKS[found.kind].most_bytes_per_s, LINKS[found.kind].name))
    for most, name in limits:
        if found.needed_bytes_per_s > most:
            yield (
                f"{found.node}: link: expected up to {_mega(most)} MB/s over {name}, got "
                f"{_mega(found.needed_bytes_per_s)}: {found.streams}{_possible(found, most)}"
            )


def unknown(node: str, found: LinkPlan | None, wanted: str) -> Iterator[str]:
    """Yield a sentence where it is not known whether a source fits the wanted link, if any."""
    if wanted and (found is None or found.needed_bytes_per_s is None):
        streams = found.streams if found else "what it sends"
        yield f"{node}: link: not known whether {streams} fits {LINKS[wanted].name}"


def doubted(found: LinkPlan) -> Iterator[str]:
    """Yield a sentence where the link may be too small."""
    if found.kind and found.needed_bytes_per_s and found.verdicts.get(found.kind) == "marginal":
        link = LINKS[found.kind]
        yield (
            f"{found.node}: link: {_mega(found.needed_bytes_per_s)} MB/s is marginal over "
            f"{link.name}, which carries {_mega(link.carries_bytes_per_s)} and "
            f"{_mega(link.most_bytes_per_s)} at best"
        )


def _mega(bytes_per_s: float) -> str:
    return f"{bytes_per_s / 1e6:.0f}"


def _possible(found: LinkPlan, most: float) -> str:
    return f"; at most {below(most / found.frame_bytes)} Hz" if found.frame_bytes else ""
