"""What a host sets itself, nobody else changes: neither a setting nor a part of it."""

from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.errors import RunError
from pipeline.fleet.relay import NodeGateway
from pipeline.protocol.orders import SwapOrder


@pytest.mark.parametrize("name", ["options", "options.device", "options.sun.low"])
def test_a_setting_that_a_host_sets_itself_is_changed_by_no_swap(name: str) -> None:
    anything: Any = SimpleNamespace(localise=lambda value, _where: value)
    plan = SimpleNamespace(nodes=[SimpleNamespace(name="capture")], is_here=lambda _: True)
    hosted: Any = SimpleNamespace(plan=plan, supervisor=object())
    gateway = NodeGateway(anything, {"capture": {"options": {"device": "/dev/video0"}}}, anything)

    with pytest.raises(RunError, match=f"capture.{name}: this host sets it itself"):
        gateway.swap(hosted, SwapOrder(node="capture", changes={name: 1}), lambda _: None)
    gateway.close()
