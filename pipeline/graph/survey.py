"""List what a graph file contains and would import, without importing it."""

from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import GraphError
from pipeline.graph.limits import MOST_EDGES
from pipeline.graph.overlay import source_document
from pipeline.graph.spec import GraphSpec, check_places, graph_spec, import_paths
from pipeline.graph.yaml_lines import YamlFile
from pipeline.import_path import check_import_path
from pipeline.settings import suggest
from pipeline.wording import shown_key


def survey(path: Path, *, source: Path | None = None, clock: str = "") -> Iterator[str]:
    """Check the file without imports, then yield lines on it; raises `FoveaError`."""
    file = YamlFile(path)
    spec = graph_spec(file, clock)
    check_places(file, spec.nodes, spec.hosts)
    _check_origins(file, spec)
    over = source_document(source) if source else None
    if over and "operator" in over.document:
        where = f"{over.at(over.document, 'operator')}: source.operator"
        check_import_path(over.document["operator"], where, GraphError)
    edges = sum(len(node.inputs) for node in spec.nodes.values())
    yield f"{path}: {spec.name}, {len(spec.nodes)} nodes, {edges} edges, {spec.clock}"
    yield "nothing was imported; a run would import, and so execute:"
    for node in spec.nodes.values():
        for found in dict.fromkeys([node.operator, *import_paths(node.settings)]):
            yield f"  {node.name}: {found}" + (" (on request)" if node.manual else "")
    for found in dict.fromkeys(import_paths(over.document if over else {})):
        yield f"  {source}: {found}"
    yield "operators were not checked: neither their settings nor their inputs and outputs"


def _check_origins(file: YamlFile, spec: GraphSpec) -> None:
    edges = [edge for node in spec.nodes.values() for edge in node.inputs.values()]
    for edge in edges:
        if edge.source not in spec.nodes:
            hint = suggest(edge.source, spec.nodes)
            raise GraphError(f"{edge.place}: {edge.where}: no node {shown_key(edge.source)}{hint}")
    if len(edges) > MOST_EDGES:
        what = f"nodes: expected up to {MOST_EDGES} edges, got {len(edges)}"
        file.fail(file.document, "nodes", what)
