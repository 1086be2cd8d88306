"""The metrics of TrackEval, which prints on import what it lacks for data sets of others."""

from contextlib import redirect_stdout
from io import StringIO
from typing import Any

from pipeline.extras import LateModule, need


def need_trackeval(where: str) -> None:
    """Import TrackEval, whose words would be in a table on standard output.

    Raises `InstallError` beginning with `where` where it is not installed.
    """
    with redirect_stdout(StringIO()):
        need("trackeval", where)


class _Metrics(LateModule):
    """The module, in a process of its own as well, where nothing has imported it before."""

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("__"):
            need_trackeval("metrics")
        return super().__getattr__(name)


metrics = _Metrics("trackeval.metrics")
