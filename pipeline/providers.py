"""Which accelerators a network may run on, and in which order they are tried."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.errors import SettingsError

AUTO, CPU = "auto", "cpu"
# by our name: what ONNX Runtime calls it, and the package that brings it; the fastest first
PROVIDERS = {
    "tensorrt": ("TensorrtExecutionProvider", "onnxruntime-gpu"),
    "cuda": ("CUDAExecutionProvider", "onnxruntime-gpu"),
    "qnn": ("QNNExecutionProvider", "onnxruntime-qnn"),
    "coreml": ("CoreMLExecutionProvider", "onnxruntime"),
    "openvino": ("OpenVINOExecutionProvider", "onnxruntime-openvino"),
    CPU: ("CPUExecutionProvider", "onnxruntime"),
}
NAMES = (AUTO, *sorted(PROVIDERS))
# on a CPU OpenVINO is slower than ONNX Runtime's own (`python -m bench.providers`), and says
# nothing of what else it may run on before it has compiled: it is taken where it is asked for
NOT_AUTOMATIC = {"openvino"}
# whose outputs of a network of eight bits are others than the CPU's (`python -m bench.providers`)
WITHOUT_EIGHT_BITS = {"openvino"}
# what ONNX Runtime calls the memory of those that have their own: inputs are written into it. Those
# that compute in the host's memory gain nothing by it: of the detector's 20.3 ms of one core at
# 480x288, it took .2 more
MEMORY = {"tensorrt": "cuda", "cuda": "cuda"}
MOST_THREADS = 64  # of a network or a node: each takes memory and time to start
CACHED = {"tensorrt", "openvino"}  # those whose compiled network is kept between starts


@dataclass(frozen=True, kw_only=True)
class NetworkSettings:
    """Settings of every node that runs a network."""

    threads: int = 1  # of the CPU
    provider: str = AUTO  # auto: the fastest that loads; or cpu, cuda, tensorrt, openvino …
    device: str = ""  # of openvino: CPU, GPU, NPU …; of cuda and tensorrt: its number; empty: first

    def __post_init__(self) -> None:
        check_threads(self.threads)
        check_provider(self.provider)
        if not re.fullmatch(r"[A-Za-z0-9_.:]{0,40}", self.device):
            raise SettingsError(
                f"device: expected a name such as GPU or 0, got {self.device[:100]!r}"
            )

    @property
    def compute(self) -> dict[str, Any]:
        """What `pipeline.inference.Network` takes of them."""
        return {"threads": self.threads, "provider": self.provider, "device": self.device}


def check_threads(count: int) -> None:
    """Raise `SettingsError` for threads that nobody has, or that take minutes to start."""
    if not 1 <= count <= MOST_THREADS:
        raise SettingsError(f"threads: expected 1 to {MOST_THREADS}, got {count}")


def check_provider(name: str) -> None:
    """Raise `SettingsError` for a provider that nobody knows."""
    if name not in NAMES:
        raise SettingsError(f"provider: expected one of {', '.join(NAMES)}, got {name[:100]!r}")


def order(asked: str, available: Sequence[str]) -> tuple[str, ...]:
    """Return our names of the providers to try, the CPU last; `available`: ONNX Runtime's names.

    >>> order("auto", ["CPUExecutionProvider", "CUDAExecutionProvider"])
    ('cuda', 'cpu')
    >>> order("openvino", ["CPUExecutionProvider"])
    ('cpu',)
    """
    check_provider(asked)
    here = [name for name, (full, _) in PROVIDERS.items() if full in available]
    automatic = [name for name in here if name not in NOT_AUTOMATIC]
    wanted = automatic if asked == AUTO else [name for name in here if name == asked]
    return tuple(dict.fromkeys((*wanted, CPU)))


def missing(asked: str, available: Sequence[str]) -> str:
    """Return a sentence for a provider that this installation does not have, else an empty one."""
    if asked == AUTO or PROVIDERS[asked][0] in available:
        return ""
    package = PROVIDERS[asked][1]
    return f"provider: {asked} is not in this installation, {package} brings it"


def unfit(name: str, network: bytes) -> str:
    """Return a sentence where a provider must not compute an ONNX network, else an empty one.

    >>> unfit("openvino", b"... DequantizeLinear ...")
    'openvino computes networks of eight bits wrongly, use the file of single precision'
    >>> unfit("openvino", b""), unfit("cuda", b"DequantizeLinear")
    ('', '')
    """
    if name in WITHOUT_EIGHT_BITS and b"DequantizeLinear" in network:
        return f"{name} computes networks of eight bits wrongly, use the file of single precision"
    return ""


def memory_of(name: str, device: str) -> tuple[str, int] | None:
    """Return whose memory a provider computes in, and its number; None for the host's.

    >>> memory_of("tensorrt", "1"), memory_of("cuda", ""), memory_of("openvino", "GPU")
    (('cuda', 1), ('cuda', 0), None)
    """
    return (MEMORY[name], int(device or 0)) if name in MEMORY else None


def options_of(name: str, threads: int, device: str, cache: Path | None) -> dict[str, str]:
    """Return ONNX Runtime's options for a provider; `cache`: where its compiled network is kept."""
    options: dict[str, str] = {}
    if name == "openvino":
        # not AUTO: with it this provider starts, and leaves every operation to ONNX Runtime
        options = {"device_type": device or "CPU", "num_of_threads": str(threads)}
        if cache is not None:
            options["cache_dir"] = str(cache)
    elif name in ("cuda", "tensorrt"):
        options = {"device_id": device or "0"}
        if name == "tensorrt" and cache is not None:
            options["trt_engine_cache_enable"] = options["trt_timing_cache_enable"] = "True"
            options["trt_engine_cache_path"] = str(cache)
    return options
