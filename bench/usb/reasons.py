"""Why each lost exposure was lost: what the driver counted in, a reason for each exposure out.

A reason that names its exposure explains that exposure and no other.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.usb.losses import Losses

NAMED = re.compile(r"exposure (\d+)")
BEFORE = "dropped"  # its sentence names the exposure after those that were lost
# reasons whose sentences name no exposure: each loss explains one that no other reason names
UNNAMED = ("stall", "header", "overflow", "link")


@dataclass(frozen=True, kw_only=True)
class Loss:
    """A loss that the driver counted; `exposure` -1: its sentence names none."""

    reason: str
    exposure: int = -1
    count: int = 1


class NotedLosses(Losses):
    """Counts as the driver does, and keeps every loss with the exposure that it names."""

    def __init__(self) -> None:
        super().__init__()
        self.noted: list[Loss] = []

    def lose(self, reason: str, sentence: str, count: int = 1) -> None:
        """Note and count lost frames."""
        named = NAMED.search(sentence)
        exposure = int(named[1]) if named else -1
        self.noted.append(Loss(reason=reason, exposure=exposure, count=count))
        super().lose(reason, sentence, count)


def explained(
    missing: Sequence[int], losses: Sequence[Loss], *, stalls: int = 0, outage: bool = False
) -> dict[str, int]:
    """Return how many of the missing exposures each reason explains; the others have none.

    An outage explains all that no other reason does.

    >>> explained([7, 8], [Loss(reason="checksum", exposure=7), Loss(reason="link")])
    {'checksum': 1, 'link': 1}
    """
    reasons: dict[int, str] = {}  # of positions in `missing`: numbers begin again with a START
    for loss in losses:
        _name(reasons, missing, loss)
    unnamed = ["stall"] * stalls
    unnamed += [
        one.reason for one in losses if one.exposure < 0 and one.reason in UNNAMED
        for _ in range(one.count)
    ]  # fmt: skip
    for position in range(len(missing)):
        if position not in reasons and unnamed:
            reasons[position] = unnamed.pop(0)
        elif position not in reasons and outage:
            reasons[position] = "outage"
    return dict(Counter(reasons.values()))


def _name(reasons: dict[int, str], missing: Sequence[int], loss: Loss) -> None:
    """Give the exposures that a loss names their reason, unless they have one."""
    if loss.reason == BEFORE:
        earlier = [k for k, exposure in enumerate(missing) if exposure < loss.exposure]
        free = [k for k in reversed(earlier) if k not in reasons]
        reasons.update(dict.fromkeys(free[: loss.count], loss.reason))
    elif loss.exposure in missing:
        reasons.setdefault(missing.index(loss.exposure), loss.reason)
