"""The package for scripts and notebooks: all names that a user needs.

    import fovea

    report = fovea.load("tracking").run(frames=100)

`load` takes a shipped graph or a file; `drive` calls one operator by hand. All other names are from
`pipeline`, for writing operators. Names are imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING

import pipeline

if TYPE_CHECKING:
    from pipeline import *  # noqa: F403
    from pipeline.run.loaded_graph import Graph, load
    from pipeline.testing import drive, header

    __version__: str

__all__ = ["Graph", "drive", "header", "load"]
__all__ += pipeline.__all__

_HOME_OF = {
    "Graph": "pipeline.run.loaded_graph",
    "load": "pipeline.run.loaded_graph",
    "drive": "pipeline.testing",
    "header": "pipeline.testing",
}

if not TYPE_CHECKING:  # type checkers see only the names above

    def __getattr__(name: str) -> object:
        """Return a name from the module that defines it."""
        if name == "__version__":
            return import_module("pipeline.version").version()
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        home = import_module(_HOME_OF[name]) if name in _HOME_OF else pipeline
        globals()[name] = getattr(home, name)
        return globals()[name]

    def __dir__() -> list[str]:
        """Return the public names."""
        return sorted({*globals(), *__all__})
