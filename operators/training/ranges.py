"""Refuse settings that are out of range, in a sentence."""

import math

from pipeline.errors import SettingsError


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
