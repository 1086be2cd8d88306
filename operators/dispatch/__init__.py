"""Dispatch: the plan of a policy as commands of a sensor."""

from operators.dispatch.dispatch import (
    Dispatch,
    DispatchSettings,
    DispatchState,
    coverage,
    plan_windows,
)

__all__ = ["Dispatch", "DispatchSettings", "DispatchState", "coverage", "plan_windows"]
