"""The figures of the loop in a few sentences, for a first look."""

from collections.abc import Sequence

EVERY_NS = 1_000_000_000  # between two texts
LOOP, TARGET, PIXELS = "latency/loop", "figures/target", "figures/pixels"


class Glance:
    """The newest figures by path, and the target's name."""

    def __init__(self) -> None:
        self.target = ""
        self._figures: dict[str, float] = {}
        self._dropped: dict[tuple[object, ...], float] = {}  # messages so far, by edge and reason
        self._told_ns: int | None = None

    def add(self, path: str | Sequence[object], value: float) -> None:
        """Take a figure that is plotted."""
        if not isinstance(path, str):
            if path[0] == "drops":
                self._dropped[tuple(path)] = value
        elif path.startswith((LOOP, TARGET, PIXELS)):
            self._figures[path] = value

    def is_due(self, now_ns: int) -> bool:
        """Return whether the text is to be shown again; then the next time is a second later."""
        due = self._told_ns is None or abs(now_ns - self._told_ns) >= EVERY_NS
        if due:
            self._told_ns = now_ns
        return due

    def text(self) -> str:
        """Return the figures that are known, as Markdown.

        >>> glance = Glance()
        >>> glance.add("figures/pixels/read", 12.5)
        >>> glance.text()
        '**Target**: none. **Read**: 12.5 % of the pixels.'
        """
        known, parts = self._figures, [f"**Target**: {self._aimed()}"]
        if (read := known.get(f"{PIXELS}/read")) is not None:
            parts.append(f"**Read**: {read:.3g} % of the pixels")
        if (ms := known.get(f"{LOOP}/p50")) is not None:
            budget_ms = known.get(f"{LOOP}/budget_p50")
            parts.append(f"**Loop**: {ms:.0f} ms" + (f" of {budget_ms:.0f}" if budget_ms else ""))
        if self._dropped:
            parts.append(f"**Dropped**: {sum(self._dropped.values()):.0f} messages")
        return ". ".join(parts) + "."

    def _aimed(self) -> str:
        if not self.target:
            return "none"
        told = [self.target]
        if (share := self._figures.get(f"{TARGET}/in_roi")) is not None:
            told.append(f"{share:.0%} of it in the ROI")
        if (overlap := self._figures.get(f"{TARGET}/iou")) is not None:
            told.append(f"IoU {overlap:.2f}")
        return ", ".join(told)
