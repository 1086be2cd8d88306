"""Configuration of sessions between hosts."""

import pytest

from pipeline.bus.clocks import MOST_HOSTS
from pipeline.bus.network import LARGEST_BYTES, Network, Permit
from pipeline.errors import SettingsError

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


@pytest.mark.parametrize("point", ["tcp/0.0.0.0:7447", "tls/0.0.0.0:7447", "udp/10.0.0.1:7447"])
@pytest.mark.parametrize("way", ["listen", "connect"])
def test_without_credentials_a_session_has_no_address_of_a_network(way: str, point: str) -> None:
    with pytest.raises(SettingsError, match=f"{point}: expected unixsock-stream/… here"):
        Network(**{way: (point,)}).config()  # type: ignore[arg-type]


@pytest.mark.parametrize("point", ["tcp/0.0.0.0:7447", "quic/10.0.0.1:7447", "unixsock-stream/x"])
@pytest.mark.parametrize("way", ["listen", "connect"])
def test_with_credentials_every_link_is_tls_in_both_directions(way: str, point: str) -> None:
    with pytest.raises(SettingsError, match=f"{point}: expected tls/… here"):
        Network(**{way: (point,)}, credentials="/mine").config()  # type: ignore[arg-type]

    tls = Network(**{way: ("tls/a:1",)}, credentials="/mine").config()  # type: ignore[arg-type]

    link = tls["transport"]["link"]["tls"]
    assert link["enable_mtls"] is True
    assert link["close_link_on_expiration"] is True
    assert link["root_ca_certificate"] == "/mine/ca.pem"


def test_a_peer_may_do_what_a_permit_names_and_nothing_else() -> None:
    permit = Permit(identity="eye", inward=("put",), outward=("query",), key="fovea/trio/eye/out")
    listen = ("tls/a:1",)

    nobody = Network(listen=listen, credentials="/mine").config()["access_control"]
    one = Network(listen=listen, credentials="/mine", permits=(permit,)).config()["access_control"]

    for control in (nobody, one):
        assert (control["enabled"], control["default_permission"]) == (True, "deny")
    assert nobody["rules"] == []
    assert one["subjects"] == [{"id": "s0", "cert_common_names": ["eye"]}]
    allowed = {(rule["permission"], *rule["flows"], *rule["messages"]) for rule in one["rules"]}
    assert allowed == {("allow", "ingress", "put"), ("allow", "egress", "query")}
    assert [rule["key_exprs"] for rule in one["rules"]] == [["fovea/trio/eye/out"]] * 2
    assert one["policies"] == [{"rules": [rule["id"] for rule in one["rules"]], "subjects": ["s0"]}]


@pytest.mark.parametrize("routes", [(), ("host.a",)])
def test_a_session_seeks_nobody_and_takes_no_message_without_a_limit(
    routes: tuple[str, ...],
) -> None:
    config = Network(listen=("unixsock-stream/there",), routes=routes).config()

    assert config["scouting"]["multicast"] == config["scouting"]["gossip"] == {"enabled": False}
    assert config["transport"]["shared_memory"] == {"enabled": False}
    assert config["transport"]["link"]["rx"] == {"max_message_size": LARGEST_BYTES}
    assert 0 < config["transport"]["unicast"]["accept_pending"] < 1000
    assert 0 < config["transport"]["unicast"]["max_sessions"] < 10_000
