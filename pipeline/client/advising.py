"""Ask an operator's advice before a swap: a plan and an order in, warnings in the log out."""

import logging
from contextlib import suppress

from pipeline.errors import GraphError, InstallError
from pipeline.graph.advice import advised, settings_behind
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import SwapOrder
from pipeline.run.swap_target import swapped

log = logging.getLogger(__name__)


def take_advice(plan: Plan, order: SwapOrder) -> None:
    """Log what the operator warns of; raises `SettingsError` for settings that cannot work.

    In the client and not in the node's process, which would keep the imported code of all nodes
    that it depends on. What fails before that, also since an operator is not installed here, is
    left to the node, which has its own words for it.
    """
    if order.node not in {node.name for node in plan.nodes}:
        return  # removed meanwhile
    wanted = swapped(plan, order, {})
    node = wanted.node(order.node)
    try:
        settings = settings_behind(wanted, node)
    except Exception:  # of operators' code
        return
    with suppress(GraphError, InstallError):
        for line in advised(wanted, node, settings) if settings else ():
            if line.startswith(f"{node.name}: warning: "):
                log.warning("%s", line.replace("warning: ", "", 1))
