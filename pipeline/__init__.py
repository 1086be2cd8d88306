"""The framework that runs any graph: messages, operator contract, bus, frame pools, runners.

Public names are imported on first use, so that a command handles signals before numpy is loaded.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.contract import Input, Operator, Output, Source
    from pipeline.errors import (
        DriverError,
        FoveaError,
        GraphError,
        InstallError,
        MessageError,
        PoolExhausted,
        RunError,
        SettingsError,
        WeightsError,
    )
    from pipeline.messages import (
        Detections,
        Frame,
        Geometry,
        Header,
        Message,
        Percept,
        RoiFeatures,
        RoiSchedule,
        Scanpath,
        Shape,
        Span,
        Tracks,
        Truth,
    )

__all__ = [
    "Detections",
    "DriverError",
    "FoveaError",
    "Frame",
    "Geometry",
    "GraphError",
    "Header",
    "Input",
    "InstallError",
    "Message",
    "MessageError",
    "Operator",
    "Output",
    "Percept",
    "PoolExhausted",
    "RoiFeatures",
    "RoiSchedule",
    "RunError",
    "Scanpath",
    "SettingsError",
    "Shape",
    "Source",
    "Span",
    "Tracks",
    "Truth",
    "WeightsError",
]

_HOMES = ("pipeline.contract", "pipeline.errors", "pipeline.messages")

if not TYPE_CHECKING:  # type checkers see only the names above

    def __getattr__(name: str) -> object:
        """Return a public name from the module that defines it."""
        if name in __all__:
            for home in _HOMES:
                module = import_module(home)
                if getattr(vars(module).get(name), "__module__", "") == home:
                    globals()[name] = vars(module)[name]
                    return globals()[name]
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        """Return the public names."""
        return sorted({*globals(), *__all__})
