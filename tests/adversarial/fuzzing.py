"""Run the fuzzers in a process with its own /tmp and /dev/shm, where the machine allows it.

python -m tests.adversarial.fuzzing graphs|orders|wire COUNT SEED
"""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.fuzz.graphs import fuzz_graphs
from bench.fuzz.orders import fuzz_orders
from bench.fuzz.tally import Tally
from bench.fuzz.wire import fuzz_wire
from tests.pipeline.run.namespaces import ROOT, permitted, with_small_mounts
from tests.sample_graphs import CHAIN, LOOP

PLACES = ("/tmp", "/dev/shm")
LONGEST_S = 4 * 3600.0  # of the long runs


@dataclass
class Fuzzed:
    """The tally of a run, and the files that it left in folders that were empty before."""

    tally: Tally
    left: list[str]


def fuzzed(what: str, count: int, seed: int) -> Fuzzed:
    """Fuzz `count` cases in another process; raises `AssertionError` when that process fails."""
    words = ("-m", "tests.adversarial.fuzzing", what, str(count), str(seed))
    if permitted():
        sizes = dict.fromkeys(own_places(), "512m")
        temporary = {"TMPDIR": "/tmp"} if "/tmp" in sizes else {}
        done = with_small_mounts(sizes, *words, timeout_s=LONGEST_S, **temporary)
    else:
        done = subprocess.run(
            [sys.executable, *words], capture_output=True, text=True, check=False, cwd=ROOT
        )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    return Fuzzed(Tally(**found["tally"]), found["left"] if permitted() else [])


def own_places() -> list[str]:
    """Return the folders of `PLACES` that hold neither this code nor the interpreter."""
    needed = [ROOT, Path(sys.prefix), Path(sys.base_prefix)]
    return [p for p in PLACES if not any(n.is_relative_to(p) for n in needed)]


def run(what: str, count: int, seed: int) -> Tally:
    """Fuzz in this process."""
    with tempfile.TemporaryDirectory() as folder:
        if what == "wire":
            return fuzz_wire(count, seed=seed)
        if what == "orders":
            return fuzz_orders(count, Path(folder), seed=seed)
        seeds = []
        for name, text in (("loop", LOOP), ("chain", CHAIN)):
            seeds.append(Path(folder) / f"{name}.yaml")
            seeds[-1].write_text(f"name: {name}\n{text}")
        (Path(folder) / "alone").mkdir()
        return fuzz_graphs(seeds, count, Path(folder) / "alone", seed=seed)


def left() -> list[str]:
    """Return the files in these folders, except the folder of graphs, which keeps their logs."""
    own = f"fovea-{os.geteuid()}"
    return sorted(
        str(path) for place in own_places() for path in Path(place).iterdir() if path.name != own
    )


if __name__ == "__main__":
    found = run(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
    print(json.dumps({"tally": asdict(found), "left": left()}))
