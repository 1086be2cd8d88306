"""Key of a unit of work: everything that determines its figures, by content."""

import json
from collections.abc import Container
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

from bench.tracking.budgets import PLANNED
from bench.tracking.cases import Case, Protocol
from bench.tracking.classes import planned
from bench.tracking.clip import ClipName, frames_of
from bench.tracking.stages import NEEDED
from drivers.datasets.sequence import read_info
from operators.training.identity import of_code, of_nodes
from pipeline.errors import DriverError
from pipeline.fleet.placement import file_digest
from pipeline.graph.plan import Plan
from pipeline.weights import MANIFEST

TRACKING = ("budgets", "classes", "clip", "episode", "job", "replaced", "stages", "targets")
CODE = (  # what figures come from, beside the operators that a case needs
    *("drivers", "pipeline.boxes", "pipeline.inference", "pipeline.messages"),
    *(f"bench.tracking.{name}" for name in TRACKING),
)


def key(case: Case, protocol: Protocol) -> str:
    """Tells units of a clip apart.

    Other settings, networks or code make another key, as far as the case needs the parts: a
    strategy that plans nothing needs the tracker alone. Where files lie makes none.
    """
    plan = planned(Path(protocol.graph), *case.parts)
    wanted = NEEDED if case.strategy in PLANNED else ("tracker",)
    plain = asdict(
        replace(case, changes=(), tracker="", policy="")
    )  # what they change the parts tell
    common = asdict(replace(protocol, graph=""))  # of the graph, its parts count
    known = file_digest(MANIFEST)  # what the tracker takes where the graph names no file
    parts = contents(plan, wanted)
    return json.dumps([plain, common, of_code(*CODE), parts, known], sort_keys=True)


def contents(plan: Plan, names: Container[str]) -> str:
    """Settings, code and networks of some parts of a graph."""
    return json.dumps(of_nodes(node for node in plan.nodes if node.name in names), sort_keys=True)


def clip_key(name: ClipName, frames: tuple[int, int]) -> str:
    """Tells clips apart by what is read of them: truth and pictures, wherever they lie.

    A copy has other dates, and a picture can change without its size; reading it takes a
    thirtieth of what decoding it takes. Raises `DriverError` for what is not there.
    """
    if not name.folder:
        return f"seed {name.seed}"
    folder, info = Path(name.folder), read_info(Path(name.folder))
    files = [folder / "seqinfo.ini", folder / "gameinfo.ini", folder / "gt" / "gt.txt"]
    files += [info.picture_path(index) for index in frames_of(name, frames)]
    try:
        whole = "".join(file_digest(file) for file in files)
    except OSError as error:
        raise DriverError(f"{error.filename}: cannot be read: {error.strerror}") from error
    return sha256(whole.encode()).hexdigest()
