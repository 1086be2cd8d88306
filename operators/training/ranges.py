"""Range checks of training settings, without torch."""

import math
import re

from pipeline.errors import SettingsError

DEVICES = "auto, cpu, cuda, cuda:N or mps"
_DEVICE = re.compile(r"auto|cpu|mps|cuda(:\d+)?")


def known_device(name: str) -> None:
    """Raise `SettingsError` for the name of no device; whether it is there, `device_of` says."""
    if not _DEVICE.fullmatch(name):
        raise SettingsError(f"device: expected {DEVICES}, got {name}")


def at_least(least: float, settings: object, *names: str) -> None:
    """Raise `SettingsError` for a setting that is below, or not finite."""
    for name in names:
        value = getattr(settings, name)
        if not (math.isfinite(value) and value >= least):
            raise SettingsError(f"{name}: must be at least {least:g}, got {value}")


def above_zero(settings: object, *names: str) -> None:
    """Raise `SettingsError` for a setting that is not positive, or not finite."""
    for name in names:
        value = getattr(settings, name)
        if not (math.isfinite(value) and value > 0):
            raise SettingsError(f"{name}: must be above 0, got {value}")
