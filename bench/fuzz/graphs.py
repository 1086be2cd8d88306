"""Load malformed graph files: each is refused in one sentence, or gives a plan."""

import random
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bench.fuzz import nasty
from bench.fuzz.tally import Tally, Watch
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.survey import survey
from pipeline.graph.yaml_lines import YamlFile, plain

CHANGES = ("capture.seed=3", "dispatch.mode=hold", "policy.target=[1", "a", "capture.x.y=1")


def fuzz_graphs(
    seeds: Sequence[Path], count: int, folder: Path, *, seed: int = 0, no_import: bool = False
) -> Tally:
    """Load `count` malformed versions of valid graph files from an empty folder."""
    rng, tally, watch = random.Random(seed), Tally(), Watch(folder)
    texts = [path.read_bytes() for path in seeds]
    documents = [plain(YamlFile(path).document) for path in seeds]
    for path in seeds:  # so that imports are done before files are watched
        load(path)
    path = folder.resolve() / "graph.yaml"
    for number in range(count):
        data = _case(rng, texts, documents)
        path.write_bytes(data)
        change = rng.choice(CHANGES) if rng.random() < 0.05 else ""
        overlay = Overlay(changes=(change,) if change else ())
        act = partial(load, path, overlay)
        watch.on = True
        tally.check(data, act, lambda said: f"{path}" in said or said.startswith("--set"))
        if no_import or number % 10 == 0:
            tally.check(data, lambda: list(survey(path)), lambda said: f"{path}:" in said)
        watch.on = False
    path.unlink(missing_ok=True)
    left = {found.name for found in folder.rglob("*")}
    return tally.with_touched(watch.touched | left)


def _case(rng: random.Random, texts: list[bytes], documents: list[object]) -> bytes:
    kind, which = rng.random(), rng.randrange(len(texts))
    if kind < 0.55:
        document = nasty.spoilt(documents[which], rng, rng.choice((1, 1, 1, 2, 5)))
        return nasty.written(document).encode("utf-8", "surrogatepass")
    if kind < 0.8:
        return nasty.flipped(texts[which], rng)
    if kind < 0.95:
        lines = texts[which].decode().splitlines()
        for _ in range(rng.choice((1, 2, 5))):
            at = rng.randrange(len(lines) + 1)
            extra = rng.choice((*nasty.RAW, *lines))
            lines[at : at + rng.randrange(2)] = [rng.choice(("", "  ", "    ")) + extra]
        return "\n".join(lines).encode("utf-8", "surrogatepass")
    return rng.randbytes(rng.randrange(200))
