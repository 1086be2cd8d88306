"""Lost frames by reason: all are counted, and one a second of each reason is reported."""

import logging
import time
from collections import Counter

INTERVAL_S = 1.0  # between two sentences about the same reason
log = logging.getLogger(__name__)


class Losses(Counter[str]):
    """Counts by reason."""

    def __init__(self) -> None:
        super().__init__()
        self._reported: dict[str, tuple[float, int]] = {}  # when, and the count then

    def lose(self, reason: str, sentence: str, count: int = 1) -> None:
        """Count lost frames; log the sentence unless this reason had one within a second."""
        self[reason] += count
        now_s = time.monotonic()
        reported_s, before = self._reported.get(reason, (now_s - INTERVAL_S, self[reason] - count))
        if now_s - reported_s < INTERVAL_S:
            return
        unreported = self[reason] - before - count
        log.warning("%s%s", sentence, f" ({unreported} more before it)" if unreported else "")
        self._reported[reason] = now_s, self[reason]
