"""Run ONNX networks on the CPU or an accelerator: named arrays in, named arrays out.

The only module that imports ONNX Runtime.
"""

import hashlib
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import WeightsError
from pipeline.providers import (
    AUTO,
    CACHED,
    CPU,
    PROVIDERS,
    WITHOUT_EIGHT_BITS,
    memory_of,
    missing,
    options_of,
    order,
    unfit,
)
from pipeline.text import harmless
from pipeline.weights import default_folder, pull_hint

# otherwise the library sends telemetry: a machine id and an event per session
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime  # reads that variable at import

log = logging.getLogger(__name__)
MOST_REASON = 300  # characters of what the library says
HALF = "tensor(float16)"


class Network:
    """A loaded ONNX file. `threads` bounds the cores one call uses; calls are not re-entrant.

    `provider` says what computes, a name of `pipeline.providers`; `auto`: the fastest that loads.
    One that does not load is warned of once, and the next is taken, at last the CPU; the attribute
    `provider` then says which. Raises `WeightsError` for a file that no provider can load.

    `inputs` and `outputs` hold shapes by name, with a text or None for an open side; `input_types`
    the library's names of types, such as tensor(float).
    """

    def __init__(
        self, path: str | Path, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        path = Path(path)
        if not path.is_file():
            raise WeightsError(f"{path}: no such weights{pull_hint(path)}")
        self.provider, self._session = _loaded(path, threads, provider, device)
        self.path, self._asked = path, provider
        memory = memory_of(self.provider, device)
        self._run = Bound(self._session, *memory) if memory else self._plain
        self.input_types = {i.name: str(i.type) for i in self._session.get_inputs()}
        self._half = {name for name, kind in self.input_types.items() if kind == HALF}
        self.inputs = {i.name: i.shape for i in self._session.get_inputs()}
        self.outputs = {o.name: o.shape for o in self._session.get_outputs()}
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def where(self) -> dict[str, str]:
        """What it runs on, for an operator's `summary`."""
        return {f"provider of {self.path.name}": self.provider}

    def headline(self) -> str:
        """What it runs on, for an operator's `headline`.

        Nothing for the CPU where nothing else was asked for or is installed.
        """
        if self._asked not in (AUTO, CPU, self.provider):
            return f"{self.path.stem} on {self.provider}, {self._asked} does not load"
        alone = self.provider == CPU and (self._asked == CPU or available() == (CPU,))
        return "" if alone else f"{self.path.stem} on {self.provider}"

    def __call__(self, feeds: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Run once: arrays by input name -> arrays by output name.

        Inputs of half precision are converted to it, and outputs of it to single precision. Raises
        `WeightsError` for arrays that the network cannot compute with.
        """
        given = {n: a.astype(np.float16) if n in self._half else a for n, a in feeds.items()}
        try:
            results = self._run(given)
        except Exception as error:  # as above
            why = harmless(str(error), MOST_REASON)
            raise WeightsError(f"{self.path}: cannot run on {_shapes(feeds)}: {why}") from error
        return {name: _single(np.asarray(r)) for name, r in zip(self.outputs, results, strict=True)}

    def _plain(self, feeds: Mapping[str, NDArray[Any]]) -> list[Any]:
        return list(self._session.run(None, feeds))


class Bound:
    """Runs a session whose inputs lie in a device's memory, written there once a call.

    An input keeps its place there as long as its shape and type stay. Outputs are the caller's.
    """

    def __init__(self, session: onnxruntime.InferenceSession, memory: str, number: int) -> None:
        """`memory`: cuda, or cpu for the host's; `number`: of the device."""
        self._session, self._memory, self._number = session, memory, number
        self._binding = session.io_binding()
        self._inputs = {given.name for given in session.get_inputs()}
        self._outputs = [output.name for output in session.get_outputs()]
        self._places: dict[str, tuple[tuple[int, ...], np.dtype[Any], onnxruntime.OrtValue]] = {}

    def __call__(self, feeds: Mapping[str, NDArray[Any]]) -> list[Any]:
        """Return the outputs in their order; raises what the library raises.

        Raises `ValueError` unless every input is given and nothing else: what is still bound from
        an earlier call would be computed with.
        """
        if feeds.keys() != self._inputs:
            raise ValueError(f"expected inputs {_named(self._inputs)}, got {_named(feeds)}")
        for name, array in feeds.items():
            self._put(name, np.ascontiguousarray(array))
        self._binding.clear_binding_outputs()  # else the next call would write into these
        for name in self._outputs:
            self._binding.bind_output(name)
        self._session.run_with_iobinding(self._binding)
        return list(self._binding.copy_outputs_to_cpu())

    def _put(self, name: str, array: NDArray[Any]) -> None:
        shape, kind, place = self._places.get(name, (None, None, None))
        if place is None or (shape, kind) != (array.shape, array.dtype):
            place = onnxruntime.OrtValue.ortvalue_from_shape_and_type(
                array.shape, array.dtype, self._memory, self._number
            )
            self._binding.bind_ortvalue_input(name, place)
            self._places[name] = array.shape, array.dtype, place
        place.update_inplace(array)


def available() -> tuple[str, ...]:
    """Return our names of the providers that this installation has."""
    here = onnxruntime.get_available_providers()
    return tuple(name for name, (full, _) in PROVIDERS.items() if full in here)


def _loaded(
    path: Path, threads: int, asked: str, device: str
) -> tuple[str, onnxruntime.InferenceSession]:
    """Return the provider that computes a network, and its session."""
    here: Sequence[str] = onnxruntime.get_available_providers()
    if sentence := missing(asked, here):
        log.warning("%s; %s runs on the CPU", sentence, path.name)
    for name in order(asked, here):
        if why := unfit(name, path.read_bytes()) if name in WITHOUT_EIGHT_BITS else "":
            log.warning("provider: %s: %s", path.name, why)
            continue
        try:
            session = _session(
                path, threads, name, options_of(name, threads, device, _cache_of(path, name))
            )
        except Exception as error:  # the library's errors share no base class
            why = harmless(str(error), MOST_REASON)
            if name == CPU:
                raise WeightsError(f"{path}: not a network that can be loaded: {why}") from error
            log.warning("provider: %s does not load %s: %s", name, path.name, why)
            continue
        if name == CPU or _computes(session, name):
            return name, session
        log.warning("provider: %s takes no part of %s here", name, path.name)
    raise WeightsError(f"{path}: expected ONNX Runtime with its CPU, got {', '.join(here)}")


def _computes(session: onnxruntime.InferenceSession, name: str) -> bool:
    """Whether a provider computes anything of a network.

    Where its libraries are missing or it cannot do the operations, the session starts all the same,
    names the provider, and quietly computes on the CPU.
    """
    parts = session.get_provider_graph_assignment_info()
    return any(part.ep_name == PROVIDERS[name][0] for part in parts)


def _session(
    path: Path, threads: int, name: str, given: dict[str, str]
) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # a spinning thread pool would take cores that the other stages of the graph need
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    chosen: list[Any] = [(PROVIDERS[name][0], given)]
    if name != CPU:
        options.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
        chosen.append(PROVIDERS[CPU][0])  # for operations that the accelerator does not have
    return onnxruntime.InferenceSession(str(path), options, providers=chosen)


def _cache_of(path: Path, name: str) -> Path | None:
    """Return the folder of a network compiled for a provider, by the network's checksum."""
    if name not in CACHED:
        return None
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    folder = default_folder().parent / "engines" / f"{digest[:16]}-{name}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        log.warning("%s: compiled networks are not kept: %s", folder, error.strerror)
        return None
    return folder


def _single(array: NDArray[Any]) -> NDArray[Any]:
    return array.astype(np.float32) if array.dtype == np.float16 else array


def _named(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _shapes(feeds: Mapping[str, NDArray[Any]]) -> str:
    return ", ".join(f"{name} {array.shape}" for name, array in feeds.items())
