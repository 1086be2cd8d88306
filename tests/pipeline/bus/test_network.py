"""Configuration of sessions between hosts."""

import pytest

from pipeline.bus.clocks import MOST_HOSTS
from pipeline.bus.network import Network

GIVEN_UP_PER_S = 10.0  # Zenoh's TLS listener pauses 100 ms after a handshake that was given up


@pytest.mark.parametrize(
    ("network", "links_per_host"),
    [
        (Network(listen=("unixsock-stream/there",)), 1),
        # those of its agent, of its part of a graph, of a process with an edge
        (Network(connect=("unixsock-stream/there",), region="host.a"), 3),
        (Network(listen=("unixsock-stream/there",), routes=("host.a",)), 3),
    ],
    ids=["direct", "behind a router", "router"],
)
def test_a_fleet_that_loses_patience_at_once_is_skipped_faster_than_it_tries_again(
    network: Network, links_per_host: int
) -> None:
    patience_s = network.config()["transport"]["unicast"]["open_timeout"] / 1000

    assert MOST_HOSTS * links_per_host / patience_s < GIVEN_UP_PER_S
