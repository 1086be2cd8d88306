"""Damaged descriptions from a camera: what is read, judged, or refused in one sentence.

The library is not asked here: it crashes on some of what `vetted_nodes` refuses.
"""

import random
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bench.fuzz.descriptions import SMALL, mutated
from bench.fuzz.tally import Tally, Watch
from drivers.genicam.formats import entry_of, offered
from drivers.genicam.foveation import STREAMING, foveation
from drivers.genicam.values import NodeValues
from drivers.genicam.vetting import vetted_nodes

MOST_SENTENCE = 400  # characters
ASKED = ("Width", "Height", "OffsetX", "OffsetY", "BinningHorizontal", "DecimationVertical",
         "AcquisitionFrameRate", "PixelFormat", "SequencerSetSelector")  # fmt: skip


def fuzz_genicam(count: int, descriptions: Sequence[Path] = (), *, seed: int = 0) -> Tally:
    """Read `count` damaged versions of descriptions; without any, of a small one of its own."""
    rng, tally = random.Random(seed), Tally()
    texts = {path.name: path.read_bytes() for path in descriptions} or {"small": SMALL}
    watch = Watch()
    for number in range(count):
        name = rng.choice(list(texts))
        text = mutated(texts[name], seed * count + number)
        watch.on = True
        tally.check((name, seed * count + number), partial(judged, text), short)
        watch.on = False
    return tally.with_touched(watch.touched)


def judged(text: bytes) -> str:
    """Ask a description what the driver asks of it; return the verdict on foveation."""
    nodes = vetted_nodes(text)
    for name in offered(nodes):
        entry_of(nodes, name)
    values = NodeValues(nodes, given=STREAMING)
    for name in ASKED:
        values.limits(name)
        values.locked(name)
        values.there(name)
    found = foveation(nodes)
    found.roi_sizes_px()
    if not (found.means or found.reason):
        raise AssertionError("neither a way to foveate nor a reason against it")
    return found.reason or found.means


def short(sentence: str) -> bool:
    """Whether a refusal can be shown on a line or two."""
    return sentence.startswith("description of the camera: ") and len(sentence) <= MOST_SENTENCE
