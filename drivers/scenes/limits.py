"""What every procedural scene takes, and refuses."""

from pipeline.errors import SettingsError

LEAST_PX, MOST_PX = (160, 90), (16384, 16384)  # width, height
MOST_HZ = 1000


def check_scene(size_px: tuple[int, int], rate_hz: float, seed: int, length: int | None) -> None:
    """Raise `SettingsError` for a size, rate, seed or length (None: endless) out of range."""
    if len(size_px) != 2 or not all(
        low <= side <= high for side, low, high in zip(size_px, LEAST_PX, MOST_PX, strict=True)
    ):
        raise SettingsError(f"size_px: expected {LEAST_PX} to {MOST_PX}, got {size_px}")
    if not 1 <= rate_hz <= MOST_HZ:
        raise SettingsError(f"rate_hz: expected 1 to {MOST_HZ}, got {rate_hz}")
    if seed < 0:
        raise SettingsError(f"seed: must be at least 0, got {seed}")
    if length is not None and length < 0:
        raise SettingsError(f"length: must be at least 0, got {length}")
