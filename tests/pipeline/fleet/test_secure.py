"""Credentials are completed after an interruption and renewed before they end."""

import datetime
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509

from pipeline.cli.fleet import secure_commands
from pipeline.errors import SettingsError
from pipeline.fleet import secure
from pipeline.fleet.names import node_identity
from pipeline.fleet.provisioning import check_addressed, issue_for
from pipeline.naming import LONGEST_NAME
from tests.pipeline.fleet.agents import TRIO, plan_of


def ends(credentials: secure.Credentials) -> datetime.datetime:
    return x509.load_pem_x509_certificate(credentials.certificate.read_bytes()).not_valid_after_utc


def test_credentials_that_end_soon_are_renewed_for_the_same_key_and_others_are_not(
    tmp_path: Path,
) -> None:
    secure.create(tmp_path)
    soon = secure.issue(tmp_path / "host.a", tmp_path, "host.a", days=89)
    inner = secure.issue(tmp_path / "host.a/nodes/node.g.n", tmp_path, "node.g.n", days=10)
    late = secure.issue(tmp_path / "host.b", tmp_path, "host.b", days=91)
    key, before = soon.key.read_bytes(), late.certificate.read_bytes()

    words = ["add", str(tmp_path), "--user", "alice"]
    done = CliRunner().invoke(secure_commands, words, catch_exceptions=False)

    assert {line for line in done.output.splitlines() if "renewed for 825 days" in line} == {
        line for line in done.output.splitlines() if "host.a" in line
    }
    wanted = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=800)
    assert ends(soon) > wanted
    assert ends(inner) > wanted
    assert (soon.identity, soon.key.read_bytes()) == ("host.a", key)
    assert late.certificate.read_bytes() == before
    assert not list(secure.renew(tmp_path))


@pytest.mark.parametrize("lost", ["own.pem", "ca.pem", "own.key"])
def test_credentials_whose_making_was_interrupted_are_made_whole(lost: str, tmp_path: Path) -> None:
    secure.create(tmp_path)
    own = secure.issue(tmp_path / "host.a", tmp_path, "host.a").folder
    (own / lost).unlink()
    (own / f"{lost}.part").write_text("half of it")

    credentials = secure.issue(own, tmp_path, "host.a")

    certificate = x509.load_pem_x509_certificate(credentials.certificate.read_bytes())
    authority = x509.load_pem_x509_certificate(credentials.authority.read_bytes())
    certificate.verify_directly_issued_by(authority)
    assert certificate.public_key() == secure._key(credentials.key).public_key()


def test_an_authority_whose_making_was_interrupted_is_made_whole(tmp_path: Path) -> None:
    secure.create(tmp_path)
    (tmp_path / "ca.pem").unlink()

    secure.create(tmp_path)

    assert secure.issue(tmp_path / "host.a", tmp_path, "host.a").identity == "host.a"


def test_a_name_too_long_for_a_certificate_is_refused_before_anything_is_made(
    tmp_path: Path,
) -> None:
    graph, folder = tmp_path / "graph.yaml", tmp_path / "ca"
    text = TRIO.replace("name: trio", f"name: {'a' * LONGEST_NAME}")
    graph.write_text(text.replace("capture", "c" * LONGEST_NAME))
    hosts = [f"--host={label}={label}" for label in ("sensor", "compute", "viewer")]

    with pytest.raises(SettingsError, match=r"expected a name of up to 64 characters, .* got 70"):
        CliRunner().invoke(
            secure_commands, ["init", str(folder), *hosts, f"--graph={graph}"],
            catch_exceptions=False,
        )  # fmt: skip

    assert not folder.exists()
    with pytest.raises(SettingsError, match="up to 64 characters"):
        secure.issue(tmp_path / "own", tmp_path, "user." + "x" * 60)


def test_a_part_of_an_identity_cannot_contain_the_separator(tmp_path: Path) -> None:
    node = plan_of(tmp_path).nodes[0]

    assert node_identity("a-b", replace(node, name="c")) == "node.a-b.c"
    with pytest.raises(SettingsError, match=r"name: expected up to 32 letters, .* got 'a\.b'"):
        node_identity("a.b", node)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"a": 1}', "\xff"])
def test_a_damaged_file_of_addresses_is_refused_in_one_sentence(text: str, tmp_path: Path) -> None:
    secure.create(tmp_path)
    note = tmp_path / "user.alice" / secure.ADDRESSES
    note.parent.mkdir()
    note.write_text(text)

    with pytest.raises(SettingsError, match="expected label: address"):
        check_addressed(tmp_path, {}, [])
    with pytest.raises(SettingsError, match="expected label: address"):
        list(issue_for(tmp_path, {}, [], ["alice"]))
