"""Key of a unit of work: everything that determines its figures, by content."""

import json
from collections.abc import Container, Sequence
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

from bench.tracking.budgets import PLANNED, PURSUIT
from bench.tracking.cases import Case, Protocol
from bench.tracking.classes import POLICY, planned
from bench.tracking.clip import ClipName, frames_of
from bench.tracking.sight import PERCEPTION
from bench.tracking.stages import KITS, NEEDED, VERIFYING
from drivers.datasets.sequence import read_info
from operators.training.identity import of_code, of_nodes
from pipeline.errors import DriverError
from pipeline.fleet.placement import file_digest
from pipeline.graph.plan import Plan
from pipeline.weights import MANIFEST

TRACKING = (
    *("budgets", "camera", "classes", "clip", "consumer", "cue", "episode", "job"),
    *("replaced", "roi_path", "sight", "stages", "stock", "targets"),
)
# what determines figures, besides the operators that a case needs and what these share
CODE = ("drivers", *(f"bench.tracking.{name}" for name in TRACKING))


def key(case: Case, protocol: Protocol) -> str:
    """Return the key of a case, which tells units of a clip apart.

    It depends on settings, networks and code of the parts that the case needs (a strategy without a
    plan needs only the tracker), not on the paths of files.
    """
    plan = planned(Path(protocol.graph), *case.parts)
    played = (*NEEDED, *VERIFYING, KITS)  # those that verify and kits count where a graph has them
    wanted = played if case.strategy in PLANNED else ("tracker",)
    plain = asdict(replace(case, changes=(), tracker="", policy=""))  # `parts` reflects these
    common = asdict(replace(protocol, graph=""))  # only the graph's parts count
    known = file_digest(MANIFEST)  # of the tracker's weights if the graph names no file
    parts = contents(plan, wanted)
    cue = ""
    if case.rules.cue:
        giver = planned(Path(protocol.graph), case.changes, case.tracker, PURSUIT)
        cue = contents(giver, (*PERCEPTION, KITS, POLICY))
    return json.dumps([plain, common, of_code(*CODE), parts, cue, known], sort_keys=True)


def contents(plan: Plan, names: Container[str]) -> str:
    """Return settings, code and networks of some parts of a graph, as text."""
    return json.dumps(of_nodes(node for node in plan.nodes if node.name in names), sort_keys=True)


def clip_key(name: ClipName, frames: tuple[int, int]) -> str:
    """Return the key of a clip, made from its truth and pictures and not from their paths.

    Dates and sizes would not do: a copy has other dates, and a picture can change without its size.
    Reading a picture takes a thirtieth of the time of decoding it. Raises `DriverError` for a file
    that cannot be read.
    """
    if not name.folder:
        return f"{name.scene} seed {name.seed}"
    folder, info = Path(name.folder), read_info(Path(name.folder))
    files = [folder / "seqinfo.ini", folder / "gameinfo.ini", folder / "gt" / "gt.txt"]
    files += [info.picture_path(index) for index in frames_of(name, frames)]
    try:
        whole = "".join(file_digest(file) for file in files)
    except OSError as error:
        raise DriverError(f"{error.filename}: cannot be read: {error.strerror}") from error
    return sha256(whole.encode()).hexdigest()


def unit_files(
    folder: Path, name: ClipName, frames: tuple[int, int], keys: Sequence[str]
) -> list[Path]:
    """Return the file of each key's unit of a clip; raises as `clip_key`."""
    content = clip_key(name, frames)
    digests = [sha256(f"{key} {content}".encode()).hexdigest() for key in keys]
    return [folder / f"{name}-{digest[:16]}.json" for digest in digests]
