"""Run ONNX networks on the CPU: named arrays in, named arrays out.

The only module that imports ONNX Runtime.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import WeightsError
from pipeline.text import harmless
from pipeline.weights import pull_hint

# otherwise the library sends telemetry: a machine id and an event per session
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime  # reads that variable at import

MOST_REASON = 300  # characters of what the library says
HALF = "tensor(float16)"


class Network:
    """A loaded ONNX file. `threads` bounds the cores one call uses; calls are not re-entrant.

    `inputs` and `outputs` hold shapes by name, with a text or None for an open side; `input_types`
    the library's names of types, such as tensor(float).
    """

    def __init__(self, path: str | Path, *, threads: int = 1) -> None:
        path = Path(path)
        if not path.is_file():
            raise WeightsError(f"{path}: no such weights{pull_hint(path)}")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        # a spinning thread pool would take cores that the other stages of the graph need
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # the library's errors share no base class
            why = harmless(str(error), MOST_REASON)
            raise WeightsError(f"{path}: not a network that can be loaded: {why}") from error
        self.path = path
        self.input_types = {i.name: str(i.type) for i in self._session.get_inputs()}
        self._half = {name for name, kind in self.input_types.items() if kind == HALF}
        self.inputs = {i.name: i.shape for i in self._session.get_inputs()}
        self.outputs = {o.name: o.shape for o in self._session.get_outputs()}
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def __call__(self, feeds: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Run once: arrays by input name -> arrays by output name.

        Inputs of half precision are converted to it, and outputs of it to single precision. Raises
        `WeightsError` for arrays that the network cannot compute with.
        """
        given = {n: a.astype(np.float16) if n in self._half else a for n, a in feeds.items()}
        try:
            results = self._session.run(None, given)
        except Exception as error:  # as above
            why = harmless(str(error), MOST_REASON)
            raise WeightsError(f"{self.path}: cannot run on {_shapes(feeds)}: {why}") from error
        return {name: _single(np.asarray(r)) for name, r in zip(self.outputs, results, strict=True)}


def _single(array: NDArray[Any]) -> NDArray[Any]:
    return array.astype(np.float32) if array.dtype == np.float16 else array


def _shapes(feeds: Mapping[str, NDArray[Any]]) -> str:
    return ", ".join(f"{name} {array.shape}" for name, array in feeds.items())
