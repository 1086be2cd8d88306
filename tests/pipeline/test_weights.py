"""Weights are found by name and checksum; a refused download leaves nothing behind."""

import hashlib
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import fields
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import WeightsError
from pipeline.weights import (
    Entry,
    entries,
    find,
    pull,
    pull_hint,
    require,
    weights_commands,
    weights_file,
)
from tests.shared_data import Footage

NETWORK = bytes(range(256)) * 700  # more than one chunk

Serve = Callable[[bytes, int], str]  # body, announced size -> address


def manifest_of(folder: Path, *, url: str = "", body: bytes = NETWORK) -> Path:
    path = folder / "weights.toml"
    path.write_text(
        f'[net]\nfile = "net.onnx"\nurl = "{url}"\nsize_bytes = {len(body)}\n'
        f'sha256 = "{hashlib.sha256(body).hexdigest()}"\nlicence = "MIT"\nnote = "a test"\n'
    )
    return path


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Serve one body at a local address, announcing a size that may be wrong."""
    servers: list[tuple[ThreadingHTTPServer, threading.Thread]] = []

    def start(body: bytes, announced_bytes: int) -> str:
        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.path != "/net.onnx":
                    self.send_error(404)
                    return
                self.send_response(200)
                self.send_header("Content-Length", str(announced_bytes))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                pass

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        servers.append((server, thread))
        return f"http://127.0.0.1:{server.server_port}/net.onnx"

    yield start
    for server, thread in servers:
        server.shutdown()
        thread.join()
        server.server_close()


def test_a_download_is_found_afterwards(tmp_path: Path, serve: Serve) -> None:
    manifest = manifest_of(tmp_path, url=serve(NETWORK, len(NETWORK)))
    folder = tmp_path / "kept"

    (path,) = pull(["net"], folder=folder, manifest=manifest)

    assert path.read_bytes() == NETWORK
    assert find("net", folder, manifest=manifest) == path
    assert require("net", folder, manifest=manifest) == path
    assert list(folder.iterdir()) == [path]


@pytest.mark.parametrize(
    ("body", "announced_bytes", "message"),
    [
        (NETWORK[:-1], len(NETWORK), f"expected {len(NETWORK)} bytes, got {len(NETWORK) - 1}"),
        (NETWORK * 9, len(NETWORK) * 9, f"got more than {len(NETWORK)}"),
        (b"x" + NETWORK[1:], len(NETWORK), "expected sha256"),
        (b"", 0, f"expected {len(NETWORK)} bytes, got 0"),
    ],
    ids=["truncated", "too long", "tampered", "empty"],
)
def test_a_wrong_download_is_refused_and_leaves_nothing(
    tmp_path: Path, serve: Serve, body: bytes, announced_bytes: int, message: str
) -> None:
    manifest = manifest_of(tmp_path, url=serve(body, announced_bytes))
    folder = tmp_path / "kept"

    with pytest.raises(WeightsError, match=message):
        pull(["net"], folder=folder, manifest=manifest)

    assert list(folder.iterdir()) == []


def test_a_refused_download_leaves_the_copy_that_was_there(tmp_path: Path, serve: Serve) -> None:
    manifest = manifest_of(tmp_path, url=serve(b"tampered", 8))
    old = tmp_path / "net.onnx"
    old.write_bytes(b"old")

    with pytest.raises(WeightsError, match=r"^net: http.*expected \d+ bytes, got 8$"):
        pull(["net"], folder=tmp_path, manifest=manifest)

    assert old.read_bytes() == b"old"


def test_a_missing_page_is_reported_in_one_sentence(tmp_path: Path, serve: Serve) -> None:
    url = serve(NETWORK, len(NETWORK)) + ".gone"
    manifest = manifest_of(tmp_path, url=url)

    with pytest.raises(WeightsError, match=r"^net: http.*404"):
        pull(["net"], folder=tmp_path / "kept", manifest=manifest)


def test_a_silent_server_is_a_timeout(tmp_path: Path, serve: Serve) -> None:
    url = serve(NETWORK, len(NETWORK) + 1)  # announces a byte that never comes
    manifest = manifest_of(tmp_path, url=url, body=NETWORK + b"x")

    with pytest.raises(WeightsError, match=r"^net: http"):
        pull(["net"], folder=tmp_path / "kept", manifest=manifest, timeout_s=0.2)


def test_a_mirror_is_searched_in_its_sub_folders_for_the_right_file(tmp_path: Path) -> None:
    manifest = manifest_of(tmp_path, url="http://127.0.0.1:9/never asked")
    for name, body in {"a": b"another net", "b": NETWORK}.items():
        (tmp_path / "mirror" / name).mkdir(parents=True)
        (tmp_path / "mirror" / name / "net.onnx").write_bytes(body)

    (path,) = pull(["net"], tmp_path / "mirror", tmp_path / "kept", manifest=manifest)

    assert path.read_bytes() == NETWORK


def test_a_mirror_without_the_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "mirror").mkdir()

    with pytest.raises(WeightsError, match=r"expected net.onnx somewhere in .*mirror, got none"):
        pull(["net"], tmp_path / "mirror", tmp_path, manifest=manifest_of(tmp_path))


@given(place=st.integers(0, len(NETWORK) - 1), flip=st.integers(1, 255))
def test_any_changed_byte_of_a_mirror_is_refused(
    tmp_path_factory: pytest.TempPathFactory, place: int, flip: int
) -> None:
    folder = tmp_path_factory.mktemp("tampered")
    bad = bytearray(NETWORK)
    bad[place] ^= flip
    (folder / "net.onnx").write_bytes(bad)

    with pytest.raises(WeightsError, match="expected sha256"):
        pull(["net"], folder, folder / "kept", manifest=manifest_of(folder))

    assert list((folder / "kept").iterdir()) == []


def test_a_copy_changed_after_the_pull_is_not_found(tmp_path: Path) -> None:
    manifest = manifest_of(tmp_path)
    (tmp_path / "net.onnx").write_bytes(NETWORK)
    assert find("net", tmp_path, manifest=manifest)

    (tmp_path / "net.onnx").write_bytes(NETWORK[:-1] + b"?")

    assert find("net", tmp_path, manifest=manifest) is None
    with pytest.raises(WeightsError, match="run `fovea weights pull net`"):
        require("net", tmp_path, manifest=manifest)


def test_an_intact_copy_is_not_fetched_again(tmp_path: Path) -> None:
    manifest = manifest_of(tmp_path, url="http://127.0.0.1:9/nobody listens")
    (tmp_path / "net.onnx").write_bytes(NETWORK)

    assert pull(["net"], folder=tmp_path, manifest=manifest) == [tmp_path / "net.onnx"]


def test_weights_without_an_address_need_a_mirror(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="net: has no address"):
        pull(["net"], folder=tmp_path, manifest=manifest_of(tmp_path))


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    manifest = manifest_of(tmp_path)

    with pytest.raises(WeightsError, match=r"weights\.toml.*: cannot keep weights there: "):
        pull(["net"], folder=manifest / "kept", manifest=manifest)


@pytest.mark.parametrize("mirrored", [True, False])
def test_without_names_all_that_can_be_had_are_pulled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mirrored: bool
) -> None:
    asked: list[str] = []
    monkeypatch.setattr("pipeline.weights.pull", lambda names, *_, **__: asked.extend(names) or [])
    mirror = ["--mirror", str(tmp_path)] if mirrored else []

    done = CliRunner().invoke(weights_commands, ["pull", *mirror])

    assert done.exit_code == 0
    assert asked == [name for name, entry in entries().items() if mirrored or entry.url]
    assert not all(entry.url for entry in entries().values())  # so that the two differ


def test_pulling_is_proposed_only_for_a_file_that_the_manifest_names(tmp_path: Path) -> None:
    manifest = manifest_of(tmp_path)

    assert "fovea weights pull net`" in pull_hint(Path("there/net.onnx"), manifest=manifest)
    assert pull_hint(Path("there/mine.onnx"), manifest=manifest) == ""


def test_a_misspelt_name_gets_a_suggestion() -> None:
    with pytest.raises(WeightsError, match="did you mean vittrack"):
        find("vitrack")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('file = "net.onnx"', 'file = "../net.onnx"'), "net.file: expected a bare file name"),
        (('url = ""', 'url = "file:///etc/passwd"'), "net.url: expected https"),
        (('licence = "MIT"', "licence = 3"), "net.licence: expected a text, got 3"),
        (('note = "a test"', 'notes = "a test"'), "net: expected the fields"),
        (("[net]", "[net"), "not a manifest of weights"),
        (("sha256 = ", 'sha256 = "12" # '), "net.sha256: expected 64 hex digits, got '12'"),
    ],
)
def test_a_bad_manifest_is_refused_with_the_reason(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    path = manifest_of(tmp_path)
    path.write_text(path.read_text().replace(*change))

    with pytest.raises(WeightsError, match=message):
        entries(path)


def test_the_shipped_manifest_can_be_read_and_its_files_have_different_names() -> None:
    named = entries()

    assert {"yolox_nano", "vittrack", "nanotrack_v3_backbone"} <= set(named)
    assert len({entry.file for entry in named.values()}) == len(named)


@pytest.mark.footage
def test_the_shipped_manifest_names_what_the_mirror_holds(tmp_path: Path, footage: Footage) -> None:
    paths = pull(entries(), footage.mirror(), tmp_path)

    assert [path.name for path in paths] == [entry.file for entry in entries().values()]


def test_the_command_line_lists_and_refuses(tmp_path: Path) -> None:
    listed = CliRunner().invoke(weights_commands, ["list", "--folder", str(tmp_path)])
    refused = CliRunner().invoke(
        weights_commands, ["pull", "vittrack", "--mirror", str(tmp_path), "--folder", str(tmp_path)]
    )

    assert listed.exit_code == 0
    assert isinstance(refused.exception, WeightsError)


def test_the_list_as_json_has_what_the_manifest_says_and_where_the_file_is(tmp_path: Path) -> None:
    listed = CliRunner().invoke(weights_commands, ["list", "--json", "--folder", str(tmp_path)])

    (found, *_) = rows = json.loads(listed.output)["weights"]
    assert [row["name"] for row in rows] == list(entries())
    assert set(found) == {field.name for field in fields(Entry)} | {"path"}
    assert {row["path"] for row in rows} == {None}


def test_an_entry_of_no_bytes_is_refused() -> None:
    with pytest.raises(WeightsError, match=r"a.size_bytes: must be at least 1, got 0"):
        Entry(name="a", file="a", url="", size_bytes=0, sha256="0" * 64, licence="", note="")


@pytest.mark.parametrize("weights", ["best.pt", "runs/train/best", "model.tflite"])
def test_a_file_that_is_no_onnx_file_is_not_taken_for_a_name(weights: str, tmp_path: Path) -> None:
    with pytest.raises(
        WeightsError, match=f"{weights}: expected an ONNX file, ending in .onnx, or"
    ):
        weights_file(weights, {"": tmp_path / "shipped.onnx"})


@pytest.mark.parametrize(
    ("asked", "hint"),
    [
        ("eightbits", "did you mean eight_bits?"),
        ("vitrack", "did you mean vittrack?"),
        ("?", "known: eight_bits, larger, yolox_nano"),
    ],
)
def test_an_unknown_name_is_told_the_shipped_ones_and_those_to_pull(asked: str, hint: str) -> None:
    shipped = {name: Path(f"{name}.onnx") for name in ("", "eight_bits", "larger")}

    with pytest.raises(WeightsError) as caught:
        weights_file(asked, shipped)

    assert str(caught.value).startswith(f"{asked}: no such weights; {hint}")
    assert weights_file("larger", shipped) == Path("larger.onnx")
