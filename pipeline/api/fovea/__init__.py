"""fovea for scripts and notebooks: the names that a user needs, in one place.

    import fovea

    report = fovea.load("tracking").run(frames=100)

`load` takes a shipped graph or a file. `Operator`, `Source`, `Input`, `Output` and the messages
are what an operator is written with; `drive` hands it messages by hand. Names are imported when
they are first used.
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
        Tracks,
        Truth,
    )
    from pipeline.run.loaded_graph import Graph, load
    from pipeline.testing import drive, header

    __version__: str

_HOMES = {
    "pipeline.contract": ("Input", "Operator", "Output", "Source"),
    "pipeline.errors": (
        "DriverError", "FoveaError", "GraphError", "InstallError", "MessageError", "PoolExhausted",
        "RunError", "SettingsError", "WeightsError",
    ),
    "pipeline.messages": (
        "Detections", "Frame", "Geometry", "Header", "Message", "Percept", "RoiFeatures",
        "RoiSchedule", "Scanpath", "Shape", "Tracks", "Truth",
    ),
    "pipeline.run.loaded_graph": ("Graph", "load"),
    "pipeline.testing": ("drive", "header"),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Detections",
    "DriverError",
    "FoveaError",
    "Frame",
    "Geometry",
    "Graph",
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
    "Tracks",
    "Truth",
    "WeightsError",
    "drive",
    "header",
    "load",
]

if not TYPE_CHECKING:  # a checker shall see the names above and no others

    def __getattr__(name: str) -> object:
        """Return a name from the module that defines it."""
        if name == "__version__":
            return import_module("pipeline.version").version()
        if name not in _HOME_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(_HOME_OF[name]), name)
        return globals()[name]

    def __dir__() -> list[str]:
        """Return the public names."""
        return sorted({*globals(), *__all__})
