"""What a detector knows and whether it is shown that: metadata and a source -> sentences."""

from collections.abc import Iterable, Mapping
from typing import Any

MOST_NAMES = 8  # that are listed; COCO has 80


def advice(names: Iterable[str], metadata: Mapping[str, str], shown: Any | None) -> Iterable[str]:
    """Sentences about classes, training and source; `shown` has `shows` and `source`, or is None.

    The metadata says in `domain` what kind of scene the detector is for, in `trained_on` what it
    was trained on.
    """
    domain, trained_on = metadata.get("domain", ""), metadata.get("trained_on", "")
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
        "what it finds means nothing; another detector is set by saliency.weights"
    )


def listed(names: list[str]) -> str:
    """The names, the first of them where there are many.

    >>> listed(["player", "ball"]), listed([str(n) for n in range(80)])
    ('player, ball', '80 classes: 0, 1, 2, 3, 4, 5, 6, 7, …')
    """
    if len(names) <= MOST_NAMES:
        return ", ".join(names) or "classes without names"
    return f"{len(names)} classes: {', '.join(names[:MOST_NAMES])}, …"
