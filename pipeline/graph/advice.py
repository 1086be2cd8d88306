"""What operators say of their settings before they run (`Operator.advise`): a plan -> sentences."""

from collections.abc import Mapping
from typing import Any

from pipeline.cause import cause_of, is_signal
from pipeline.contract import BEFORE, SOURCE, settings_of
from pipeline.errors import FoveaError, GraphError, SettingsError, WeightsError
from pipeline.graph.plan import Node, Plan, load_operator, sources
from pipeline.settings import build
from pipeline.text import harmless


def advised(plan: Plan, node: Node, settings: Mapping[str, Any]) -> list[str]:
    """Return what the operator of a node says; raises `FoveaError` for what cannot work.

    `settings`: those of the node, of all nodes that it depends on and of the first source, by name.
    """
    upstream = {e.input: settings[e.source] for e in plan.inputs(node.name).values()}
    for name in _source(plan):
        upstream[SOURCE] = settings[name]
    upstream[BEFORE] = tuple(settings[name] for name in before(plan, node.name))
    try:
        lines = list(load_operator(node.operator).advise(settings[node.name], upstream))
    except WeightsError as error:
        if not node.host:  # otherwise another host has to have them
            raise WeightsError(f"{node.name}: {error}") from error
        lines = [f"on {node.host}: {error}"]
    except SettingsError as error:  # its text begins with the setting's name
        raise SettingsError(f"{node.name}.{error}") from error
    except FoveaError:
        raise
    except BaseException as error:
        if is_signal(error):
            raise
        said = f"{node.name}: {node.operator}.advise: {cause_of(error)}"
        raise GraphError(said) from error
    return [f"{node.name}: {harmless(str(line))}" for line in lines]


def settings_behind(plan: Plan, node: Node) -> dict[str, Any]:
    """Return the settings that `advised` needs; empty where a part of them is on another host."""
    names = dict.fromkeys([node.name, *before(plan, node.name), *_source(plan)])
    nodes = [plan.node(name) for name in names]
    if not all(plan.is_here(each) for each in nodes):
        return {}
    return {each.name: built(each) for each in nodes}


def built(node: Node) -> Any:
    """Return the settings of a node as its operator gets them; some load a network."""
    return build(settings_of(load_operator(node.operator)), node.settings, node.name)


def before(plan: Plan, node: str) -> list[str]:
    """Return the nodes that a node depends on, nearest first; in a loop, without itself."""
    found = [node]
    for name in found:  # it grows
        readers = (edge.source for edge in plan.inputs(name).values())
        found += [source for source in readers if source not in found]
    return found[1:]


def _source(plan: Plan) -> list[str]:
    """Return the name of the first source, or none."""
    return [node.name for node in sources(plan)][:1]
