"""Advice on a detector and its source: metadata and a source -> sentences."""

from collections.abc import Iterable
from typing import Any

from operators.saliency.description import Description

MOST_NAMES = 8  # that are listed; COCO has 80


def advice(names: Iterable[str], known: Description, shown: Any | None) -> Iterable[str]:
    """Yield sentences on classes, training and source; `shown` has `shows`, `source`, or is None.

    A detector without a `domain` is for every kind of scene.
    """
    domain, trained_on = known.domain, known.trained_on
    yield f"the detector finds {listed(list(names))}; " + (
        f"it was trained on {trained_on}"
        if trained_on
        else "its file does not say what it was trained on"
    )
    shows, source = getattr(shown, "shows", None), getattr(shown, "source", "the source")
    if not domain or shows is None or shows == domain:
        return
    seen = f"shows {shows}" if shows else "does not say what it shows"
    yield (
        f"warning: the detector is for {domain}, and {source} {seen}: of anything but {domain}, "
        "what it finds means nothing; another detector is set by this node's weights"
    )


def listed(names: list[str]) -> str:
    """The names, the first of them where there are many.

    >>> listed(["player", "ball"]), listed([str(n) for n in range(80)])
    ('player, ball', '80 classes: 0, 1, 2, 3, 4, 5, 6, 7, …')
    """
    if len(names) <= MOST_NAMES:
        return ", ".join(names) or "classes without names"
    return f"{len(names)} classes: {', '.join(names[:MOST_NAMES])}, …"
