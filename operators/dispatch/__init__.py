"""Dispatch: the plan of a policy as commands of a sensor."""

from operators.dispatch.dispatch import (
    Dispatch,
    DispatchSettings,
    DispatchState,
    plan_windows,
)
from pipeline.forecast import coverage

__all__ = ["Dispatch", "DispatchSettings", "DispatchState", "coverage", "plan_windows"]
