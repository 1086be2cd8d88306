"""Limits of a link to a camera: how long to wait for it and how often to try again."""

from dataclasses import dataclass

from pipeline.errors import SettingsError

LONGEST_S = 3600.0
MOST_DOUBLINGS = 32


@dataclass(frozen=True, kw_only=True)
class LinkSettings:
    """Limits of every wait. An outage lasts from the last frame before it to the next one."""

    open_timeout_s: float = 5.0  # for one attempt to open the camera and get its first frame
    open_wait_s: float = 0.0  # how long `open` tries again when the camera is not there; 0: once
    read_timeout_s: float = 3.0  # without a frame for longer, the link counts as lost
    outage_s: float = 8.0  # longest outage, after which `read` raises
    backoff_s: tuple[float, float] = (0.2, 2.0)  # pause between attempts: first, longest

    def __post_init__(self) -> None:
        for name in ("open_timeout_s", "read_timeout_s", "outage_s"):
            value = getattr(self, name)
            if not 0.05 <= value <= LONGEST_S:
                raise SettingsError(f"{name}: expected 0.05 to {LONGEST_S:g}, got {value:g}")
        if not 0 <= self.open_wait_s <= LONGEST_S:
            got = f"got {self.open_wait_s:g}"
            raise SettingsError(f"open_wait_s: expected 0 to {LONGEST_S:g}, {got}")
        first_s, longest_s = self.backoff_s
        if not 0.01 <= first_s <= longest_s <= LONGEST_S:
            raise SettingsError(
                f"backoff_s: expected a first pause of at least 0.01 and then a longest one, got "
                f"{first_s:g}, {longest_s:g}"
            )

    def pause_s(self, failures: int) -> float:
        """The pause after so many failed attempts in a row, doubled each time.

        >>> [LinkSettings().pause_s(failures) for failures in (1, 2, 3, 100)]
        [0.2, 0.4, 0.8, 2.0]
        """
        first_s, longest_s = self.backoff_s
        return min(longest_s, first_s * 2.0 ** min(max(0, failures - 1), MOST_DOUBLINGS))
