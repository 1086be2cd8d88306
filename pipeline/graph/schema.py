"""The JSON Schema of graph files, for editors: general, or exact for the nodes of one plan."""

from typing import Any

from pipeline.contract import inputs_of, settings_of
from pipeline.graph.loader import EDGE_KEYS, NODE_KEYS
from pipeline.graph.plan import Node, Plan, Restart, load_operator
from pipeline.settings import json_schema


def graph_schema(plan: Plan | None = None) -> dict[str, Any]:
    """A schema document; with a plan, settings and inputs of its nodes are spelled out."""
    nodes: dict[str, Any] = {"type": "object", "additionalProperties": _node()}
    if plan:
        nodes["properties"] = {node.name: _node(node) for node in plan.nodes}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "fovea graph",
        "type": "object",
        "additionalProperties": False,
        "required": ["nodes"],
        "properties": {
            "name": {"type": "string"},
            "clock": {"enum": ["realtime", "lockstep"]},
            "hosts": {"type": "array", "items": {"type": "string"}, "uniqueItems": True},
            "nodes": nodes,
        },
    }


def _node(node: Node | None = None) -> dict[str, Any]:
    settings: dict[str, Any] = {"type": "object"}
    inputs: dict[str, Any] = {"type": "object", "additionalProperties": _edge()}
    if node:
        operator = load_operator(node.operator)
        settings = json_schema(settings_of(operator))
        inputs = {
            "type": "object",
            "additionalProperties": False,
            "properties": dict.fromkeys(inputs_of(operator), _edge()),
        }
    known: dict[str, Any] = {
        "operator": {"type": "string", "pattern": "^[\\w.]+:\\w+$"},
        "inputs": inputs,
        "settings": settings,
        "group": {"type": "string"},
        "host": {"type": "string"},
        "threads": {"type": "integer", "minimum": 1},
        "stall_s": {"type": "number", "exclusiveMinimum": 0},
        "start_s": {"type": "number", "exclusiveMinimum": 0},
        "memory_mb": {"type": "number", "exclusiveMinimum": 0},
        "restart": {"anyOf": [{"enum": ["never", "on-failure", "always"]}, json_schema(Restart)]},
        "manual": {"type": "boolean"},
    }
    return {
        "type": "object",
        "additionalProperties": False,
        "required": ["operator"],
        "properties": {key: known[key] for key in NODE_KEYS},
    }


def _edge() -> dict[str, Any]:
    known: dict[str, Any] = {
        "from": {"type": "string"},
        "keep": {"enum": ["latest", "every"]},
        "depth": {"type": "integer", "minimum": 1, "maximum": 64},
        "wait_ms": {"type": "number", "minimum": 0},
        "max_age_ms": {"type": "number", "minimum": 0},
        "stale": {"enum": ["drop", "pass"]},
        "transport": {"enum": ["pool", "bytes"]},
    }
    long = {
        "type": "object",
        "additionalProperties": False,
        "required": ["from"],
        "properties": {key: known[key] for key in EDGE_KEYS},
    }
    return {"anyOf": [{"type": "string"}, long]}
