"""Generate the JSON Schema of graph files: general, or exact for the nodes of one plan."""

from typing import Any

from pipeline.bus.clocks import MOST_HOSTS
from pipeline.contract import inputs_of, settings_of
from pipeline.graph.limits import EDGE, MOST_NODES, NODE, RESTART, Limits
from pipeline.graph.plan import Node, Plan, Restart, load_operator
from pipeline.graph.spec import CHOICES, CLOCKS, EDGE_KEYS, GRAPH_KEYS, NODE_KEYS, ORIGIN
from pipeline.naming import GRAMMAR
from pipeline.settings import json_schema

NAME = {"type": "string", "pattern": f"^{GRAMMAR}$"}
IMPORT_PATH = {"type": "string", "pattern": r"^[^\s:.][^\s:]*:[^\s:.]+$"}
Schema = dict[str, Any]


def graph_schema(plan: Plan | None = None) -> Schema:
    """Return a schema document; with a plan, it includes settings and inputs of its nodes."""
    definitions: Schema = {}
    nodes: Schema = {
        "type": "object",
        "minProperties": 1,
        "maxProperties": MOST_NODES,
        "propertyNames": NAME,
        "additionalProperties": _node(definitions),
    }
    if plan:
        nodes["properties"] = {node.name: _node(definitions, node) for node in plan.nodes}
    hosts = {"type": ["array", "null"], "items": NAME, "uniqueItems": True, "maxItems": MOST_HOSTS}
    known = {"name": NAME, "clock": {"enum": list(CLOCKS)}, "hosts": hosts, "nodes": nodes}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "fovea graph",
        **_object({key: known[key] for key in GRAPH_KEYS}, ["nodes"]),
        "$defs": definitions,
    }


def _node(definitions: Schema, node: Node | None = None) -> Schema:
    settings: Schema = {"type": ["object", "null"]}
    inputs: Schema = {
        "type": ["object", "null"], "propertyNames": NAME, "additionalProperties": _edge()
    }  # fmt: skip
    if node:
        operator = load_operator(node.operator)
        own = _own(json_schema(settings_of(operator)), node.name, definitions)
        settings = {**own, "type": ["object", "null"]}
        inputs |= _object(dict.fromkeys(inputs_of(operator), _edge()), []) | {
            "type": ["object", "null"]
        }
    policies = json_schema(Restart)["properties"]["policy"]
    restart = _object({"policy": policies, **_limited(RESTART)}, [])
    known: Schema = {
        "operator": IMPORT_PATH,
        "inputs": inputs,
        "settings": settings,
        "group": NAME,
        "host": NAME,
        **_limited(NODE),
        "restart": {"anyOf": [{"enum": policies["enum"]}, restart]},
        "manual": {"type": "boolean"},
    }
    return _object({key: known[key] for key in NODE_KEYS}, ["operator"])


def _edge() -> Schema:
    choices = {key: {"enum": list(allowed)} for key, allowed in CHOICES.items()}
    origin = {"type": "string", "pattern": f"^{ORIGIN}$"}
    known: Schema = {"from": origin, **choices, **_limited(EDGE)}
    return {"anyOf": [origin, _object({k: known[k] for k in EDGE_KEYS}, ["from"])]}


def _object(properties: Schema, required: list[str]) -> Schema:
    found: Schema = {
        "type": "object", "additionalProperties": False, "properties": properties
    }  # fmt: skip
    return found | ({"required": required} if required else {})


def _limited(limits: Limits) -> Schema:
    return {name: limit.schema() for name, limit in limits.items()}


def _own(schema: Schema, node: str, definitions: Schema) -> Schema:
    """Return a settings class's schema, with its definitions moved to the document's."""
    for name, definition in schema.pop("$defs", {}).items():
        definitions[f"{node}.{name}"] = _moved(definition, node)
    moved: Schema = _moved(schema, node)
    return moved


def _moved(value: Any, node: str) -> Any:
    if isinstance(value, dict):
        return {
            k: v.replace("#/$defs/", f"#/$defs/{node}.") if k == "$ref" else _moved(v, node)
            for k, v in value.items()
        }
    return [_moved(v, node) for v in value] if isinstance(value, list) else value
