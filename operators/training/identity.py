"""Identity of a result: everything that determines it, as names and texts.

Settings count by value, files and code by content. Equal identities mean that an earlier result is
still valid. File paths, number of threads and device do not affect the result and are excluded.
"""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pipeline import settings as checked
from pipeline.contract import settings_of
from pipeline.errors import WeightsError
from pipeline.fleet.placement import code_digest, file_digest, is_code, module_file, strings
from pipeline.graph.plan import Node, Plan, load_operator
from pipeline.weights import entries, require

Identity = Mapping[str, str]
INDIFFERENT = {"data", "out", "threads", "device", "minutes", "compiled"}
SHARED = (  # with what nodes calculate, besides their own code
    *("pipeline.boxes", "pipeline.colours", "pipeline.inference", "pipeline.messages"),
    *("pipeline.pixel_formats", "pipeline.text"),
)
SHIPPED = ("bench", "drivers", "operators", "pipeline")
IMPORT_PATH = re.compile(r"\w+(\.\w+)*:\w+")
DIGITS = 16  # of a checksum: enough to tell apart, short enough to be read


def of_settings(settings: Any, *without: str) -> dict[str, str]:
    """The settings of a training; raises `WeightsError` for a file that is not there."""
    found: dict[str, Any] = {}
    for name, value in asdict(settings).items():
        found |= value if isinstance(value, dict) else {name: value}
    left_out = {*INDIFFERENT, *without}
    return {name: _words(value) for name, value in found.items() if name not in left_out}


def of_plan(plan: Plan) -> dict[str, str]:
    """A graph: what its nodes are, and how they are connected."""
    edges = sorted(f"{edge.origin} to {edge.end}" for edge in plan.edges)
    return {"edges": _words(edges), **of_nodes(plan.nodes)}


def of_nodes(nodes: Iterable[Node]) -> dict[str, str]:
    """Code, networks and settings of nodes, defaults included."""
    found = of_code(*SHARED)
    for node in nodes:
        cls = settings_of(load_operator(node.operator))
        values = checked.plain(checked.build(cls, node.settings, node.name))
        if "weights" in values:
            values["weights"] = _networks(node.operator, values["weights"])
        found |= {
            f"{node.name}.{name}": _words(value)
            for name, value in values.items()
            if name not in INDIFFERENT
        }
        found |= of_code(node.operator, *_classes_of_others(values))
    return found


def of_code(*modules: str) -> dict[str, str]:
    """Modules and packages by import path, with or without a class behind."""
    return {f"code of {module}": code_digest(module)[:DIGITS] for module in modules}


def differing(before: Identity, now: Identity) -> list[str]:
    """The names of what is not the same.

    >>> differing({"seed": "1", "rate": "0.1"}, {"seed": "2", "rate": "0.1", "steps": "3"})
    ['seed', 'steps']
    """
    return sorted(name for name in {*before, *now} if before.get(name) != now.get(name))


def _classes_of_others(values: Mapping[str, Any]) -> list[str]:
    """Import paths among settings, as a scene of one's own: classes that fovea does not ship."""
    named = {path for path in strings(values, is_code) if IMPORT_PATH.fullmatch(path)}
    others = {path for path in named if path.partition(":")[0].split(".")[0] not in SHIPPED}
    return sorted(path for path in others if module_file(path) is not None)


def _networks(operator: str, weights: str) -> list[Path | str]:
    """The files behind a node's setting.

    Empty means those beside its code, a name that only the operator knows one of them.
    """
    if weights.endswith(".onnx"):
        return [Path(weights)]
    if weights in entries():
        return [require(weights)]
    spec = find_spec(operator.partition(":")[0])
    files = sorted(Path(spec.origin).parent.glob("*.onnx")) if spec and spec.origin else []
    return [weights, *files] if weights else [*files]


def _words(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True, default=_content)


def _content(path: Path) -> str:
    if not path.is_file():
        raise WeightsError(f"{path}: no such file")
    return file_digest(path)[:DIGITS]
