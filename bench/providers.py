"""Networks on the providers of this installation: `python -m bench.providers [--json FILE]`.

Every shipped network runs on the same drawn inputs on each provider that ONNX Runtime has here.
Printed: p50 and p99 of a call in ms, with one thread of the CPU, and the greatest difference of an
output to the CPU's, of the greatest output. Calls of all providers alternate, so that other work
on the machine meets them alike.
"""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from bench.machine import facts
from bench.options import JSON, ROOT, Bench
from bench.prototype import table
from pipeline.inference import Network, available
from pipeline.providers import CPU
from pipeline.whole_file import write_whole

NETWORKS = {
    "detector": "operators/saliency/detector.onnx",
    "detector, eight bits": "operators/saliency/detector_int8.onnx",
    "encoder, 10 crops": "operators/roi_features/roi_encoder.onnx",
    "policy, 25 objects": "operators/policy/policy.onnx",
    "tracker": "operators/tracker/template.onnx",
}
OPEN = {"encoder, 10 crops": 10, "policy, 25 objects": 25}  # the open side that counts objects
SIDES_PX = (288, 480)  # of a detector's picture
WARM_UP = 5  # calls before any counts


def inputs_of(network: Network, count: int, seed: int) -> dict[str, NDArray[Any]]:
    """Draw inputs: pictures and features 0..1, masks true; open sides have `count` rows."""
    rng = np.random.default_rng(seed)
    found: dict[str, NDArray[Any]] = {}
    for name, shape in network.inputs.items():
        sides = [s if isinstance(s, int) else count for s in shape]
        if len(network.inputs) > 1:  # objects are the second side, of a batch of one
            sides[0] = 1
        if name == "images":
            sides = [1, 3, *SIDES_PX]
        if "bool" in network.input_types[name]:
            found[name] = np.ones(sides, np.bool_)
        else:
            found[name] = rng.random(sides, dtype=np.float32)
    return found


def difference(one: Mapping[str, NDArray[Any]], other: Mapping[str, NDArray[Any]]) -> float:
    """The greatest difference of any output, of that output's greatest value."""
    apart = [
        float(np.abs(one[name] - other[name]).max() / max(float(np.abs(one[name]).max()), 1e-9))
        for name in one
    ]
    return max(apart)


def measured(
    name: str, path: Path, providers: list[str], calls: int, seed: int
) -> list[dict[str, Any]]:
    """A row for each provider that loads this network."""
    networks = {}
    for provider in providers:
        network = Network(path, threads=1, provider=provider)
        if network.provider == provider:
            networks[provider] = network
    given = inputs_of(networks[CPU], OPEN.get(name, 1), seed)
    expected = networks[CPU](given)
    apart = {p: difference(expected, n(given)) for p, n in networks.items()}
    took: dict[str, list[float]] = {provider: [] for provider in networks}
    for _ in range(WARM_UP + calls):
        for provider, network in networks.items():
            began = time.perf_counter()
            network(given)
            took[provider].append((time.perf_counter() - began) * 1e3)
    return [
        {
            "network": name, "provider": provider,
            "p50 ms": round(float(np.percentile(values[WARM_UP:], 50)), 2),
            "p99 ms": round(float(np.percentile(values[WARM_UP:], 99)), 2),
            "least ms": round(min(values[WARM_UP:]), 2),
            "difference to the CPU": float(f"{apart[provider]:.2g}"),
            "calls": calls,
        }
        for provider, values in took.items()
    ]  # fmt: skip


@click.command(cls=Bench)
@click.option("--calls", default=200, show_default=True, type=click.IntRange(1, 100_000))
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0))
@JSON
def main(calls: int, seed: int, path: Path | None) -> None:
    """Compare the providers of this installation."""
    providers = list(available())
    rows = [
        row
        for name, file in track(NETWORKS.items(), "networks", console=Console(stderr=True))
        for row in measured(name, ROOT / file, providers, calls, seed)
    ]
    Console().print(table(f"providers here: {', '.join(providers)}; one thread", rows))
    if path:
        result = {
            "bench": "providers",
            **facts(),
            "seed": seed,
            "providers": providers,
            "rows": rows,
        }
        write_whole(path, json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
