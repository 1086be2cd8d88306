"""Ask every operator of a plan what it will send: plan and settings in, forecasts by node out."""

from collections.abc import Mapping
from typing import Any

from pipeline.cause import cause_of, is_signal
from pipeline.errors import DriverError, FoveaError, GraphError, MessageError, SettingsError
from pipeline.forecast import Forecast, PictureStream, Upstream
from pipeline.graph.plan import Node, Plan, load_operator
from pipeline.wording import shown


def forecasts(plan: Plan, settings: Mapping[str, Any], *, ask: bool = False) -> dict[str, Forecast]:
    """Return the forecast of every node, writers before readers.

    `settings` are the built ones by node. With `ask`, sources of this host may open their device.
    Raises `FoveaError`, beginning with the node, for what cannot work.
    """
    found: dict[str, Forecast] = {}
    for name in plan.order():
        node, edges = plan.node(name), plan.inputs(name).values()
        streams = {
            e.input: found[e.source].streams[e.output]
            for e in edges
            if not e.command and e.source in found and e.output in found[e.source].streams
        }
        fed_by = {e.input: settings[e.source] for e in edges}
        upstream = Upstream(settings=fed_by, streams=streams, ask=ask and not node.host)
        found[name] = _asked(node, settings[name], upstream)
    return found


def _asked(node: Node, settings: Any, upstream: Upstream) -> Forecast:
    operator = load_operator(node.operator)
    try:
        found = operator.forecast(settings, upstream)
    except SettingsError as error:  # its text begins with the setting's name
        raise SettingsError(f"{node.name}.{error}") from error
    except MessageError as error:
        raise SettingsError(f"{node.name}: {error}") from error
    except DriverError as error:  # of a device that was asked
        raise DriverError(f"{node.name}: {error}") from error
    except FoveaError:
        raise
    except BaseException as error:
        if is_signal(error):
            raise
        said = f"{node.name}: {node.operator}.forecast: {cause_of(error)}"
        raise GraphError(said) from error
    fits = isinstance(found, Forecast) and all(
        isinstance(stream, PictureStream) for stream in found.streams.values()
    )
    if not fits:
        raise GraphError(
            f"{node.name}: {node.operator}.forecast: expected a Forecast of PictureStreams, got "
            f"{shown(found)}"
        )
    return found
