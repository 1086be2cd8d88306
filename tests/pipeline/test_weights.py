"""Weights come verified or not at all."""

import hashlib
import http.server
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import WeightsError
from pipeline.weights import MANIFEST, find, pull, read_manifest, require, weights_commands

CONTENT = bytes(range(256)) * 1000


def write_manifest(path: Path, url: str = "", content: bytes = CONTENT) -> Path:
    path.write_text(
        f'[net]\nfile = "net.onnx"\nurl = "{url}"\nsize_bytes = {len(content)}\n'
        f'sha256 = "{hashlib.sha256(content).hexdigest()}"\nlicence = "Apache-2.0"\n'
    )
    return path


@dataclass
class Server:
    """What the local server answers, and how often it was asked."""

    url: str = ""
    body: bytes = CONTENT
    announced_bytes: int = len(CONTENT)
    status: int = 200
    asked: list[str] = field(default_factory=list)


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            state.asked.append(self.path)
            self.send_response(state.status)
            if state.announced_bytes:
                self.send_header("Content-Length", str(state.announced_bytes))
            self.end_headers()
            self.wfile.write(state.body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    httpd = http.server.HTTPServer(("127.0.0.1", 0), Handler)
    state.url = f"http://127.0.0.1:{httpd.server_port}/net.onnx"
    thread = threading.Thread(target=httpd.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield state
    httpd.shutdown()
    thread.join()
    httpd.server_close()


@pytest.fixture
def manifest(tmp_path: Path, server: Server) -> Path:
    return write_manifest(tmp_path / "weights.toml", server.url)


def left_in(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir()) if folder.exists() else []


def test_what_was_never_pulled_is_not_found(tmp_path: Path, manifest: Path) -> None:
    assert find("net", tmp_path / "w", manifest=manifest) is None
    with pytest.raises(WeightsError, match=r"no weights 'net'; try `fovea weights pull net`"):
        require("net", tmp_path / "w", manifest=manifest)


def test_a_download_is_found_afterwards(tmp_path: Path, manifest: Path) -> None:
    (path,) = pull(["net"], folder=tmp_path / "w", manifest=manifest)

    assert path.read_bytes() == CONTENT
    assert find("net", tmp_path / "w", manifest=manifest) == path
    assert require("net", tmp_path / "w", manifest=manifest) == path
    assert left_in(tmp_path / "w") == ["net.onnx"]


def test_what_is_there_is_not_fetched_again(tmp_path: Path, manifest: Path, server: Server) -> None:
    for _ in range(2):
        pull(["net"], folder=tmp_path / "w", manifest=manifest)

    assert server.asked == ["/net.onnx"]


@pytest.mark.parametrize("announced_bytes", [len(CONTENT), 0], ids=["announced", "unannounced"])
def test_a_truncated_download_is_refused(
    tmp_path: Path, manifest: Path, server: Server, announced_bytes: int
) -> None:
    server.body, server.announced_bytes = CONTENT[:-1], announced_bytes

    with pytest.raises(WeightsError, match=r"net\.onnx: expected 256000 bytes, got 255999"):
        pull(["net"], folder=tmp_path / "w", manifest=manifest)
    assert left_in(tmp_path / "w") == []


def test_a_download_that_does_not_end_is_cut(
    tmp_path: Path, manifest: Path, server: Server
) -> None:
    server.body, server.announced_bytes = CONTENT + b"x", 0

    with pytest.raises(WeightsError, match="expected 256000 bytes, got more"):
        pull(["net"], folder=tmp_path / "w", manifest=manifest)
    assert left_in(tmp_path / "w") == []


def test_a_tampered_download_is_refused_and_the_old_file_stays(
    tmp_path: Path, manifest: Path, server: Server
) -> None:
    folder = tmp_path / "w"
    folder.mkdir()
    (folder / "net.onnx").write_bytes(b"older")
    server.body = CONTENT[:-1] + b"?"

    with pytest.raises(WeightsError, match="expected sha256"):
        pull(["net"], folder=folder, manifest=manifest)
    assert left_in(folder) == ["net.onnx"]
    assert (folder / "net.onnx").read_bytes() == b"older"


def test_a_damaged_file_is_not_used_but_mended(tmp_path: Path, manifest: Path) -> None:
    folder = tmp_path / "w"
    folder.mkdir()
    (folder / "net.onnx").write_bytes(CONTENT[:-1] + b"?")

    with pytest.raises(WeightsError, match=r"expected sha256 .*, got .*pull net"):
        find("net", folder, manifest=manifest)
    pull(["net"], folder=folder, manifest=manifest)
    assert find("net", folder, manifest=manifest) is not None


def test_a_server_that_refuses_is_named(tmp_path: Path, manifest: Path, server: Server) -> None:
    server.status = 404

    with pytest.raises(WeightsError, match=r"http://.*net\.onnx: not to be had: .*404"):
        pull(["net"], folder=tmp_path / "w", manifest=manifest)


def test_a_server_that_is_silent_is_given_up(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}/net.onnx"
        manifest = write_manifest(tmp_path / "weights.toml", url)

        with pytest.raises(WeightsError, match=r"net\.onnx: not to be had: .*timed out"):
            pull(["net"], folder=tmp_path / "w", manifest=manifest, timeout_s=0.1)


def test_a_mirror_is_searched_in_every_folder_and_nothing_is_downloaded(
    tmp_path: Path, manifest: Path, server: Server
) -> None:
    for place, content in (("a", b"another of that name"), ("b/c", CONTENT)):
        (tmp_path / "mirror" / place).mkdir(parents=True)
        (tmp_path / "mirror" / place / "net.onnx").write_bytes(content)

    (path,) = pull(["net"], tmp_path / "mirror", tmp_path / "w", manifest=manifest)

    assert path.read_bytes() == CONTENT
    assert server.asked == []


def test_a_mirror_with_the_wrong_file_is_refused(tmp_path: Path, manifest: Path) -> None:
    mirror = tmp_path / "mirror"
    mirror.mkdir()

    with pytest.raises(WeightsError, match=r"mirror: expected a file net\.onnx"):
        pull(["net"], mirror, tmp_path / "w", manifest=manifest)
    (mirror / "net.onnx").write_bytes(b"not that")
    with pytest.raises(WeightsError, match=r"net\.onnx: expected sha256"):
        pull(["net"], mirror, tmp_path / "w", manifest=manifest)
    assert left_in(tmp_path / "w") == []


def test_an_entry_without_address_needs_a_mirror(tmp_path: Path) -> None:
    manifest = write_manifest(tmp_path / "weights.toml", url="")

    with pytest.raises(WeightsError, match="net: has no address, needs `--mirror`"):
        pull(["net"], folder=tmp_path / "w", manifest=manifest)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path, manifest: Path) -> None:
    (tmp_path / "w").write_text("a file, no folder")

    with pytest.raises(WeightsError, match="w: cannot be written: File exists"):
        pull(["net"], folder=tmp_path / "w", manifest=manifest)


def test_an_unknown_name_gets_a_suggestion(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="did you mean 'vittrack'"):
        find("vitrack", tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"net.onnx"', '"../net.onnx"'),
        ('url = "', 'url = "file:///etc/passwd'),
        ("size_bytes = 256000", "size_bytes = 0"),
        ('sha256 = "', 'sha256 = "g'),
        ("licence", "license"),
        ("[net]", "net = 1\n[other]"),
    ],
)
def test_a_manifest_that_is_none_is_refused(tmp_path: Path, old: str, new: str) -> None:
    path = write_manifest(tmp_path / "weights.toml")
    path.write_text(path.read_text().replace(old, new))

    with pytest.raises(WeightsError, match=r"weights\.toml: net"):
        read_manifest(path)


@given(text=st.text())
def test_no_text_whatever_breaks_the_reader_of_manifests(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))

    with suppress(WeightsError):  # the only way to fail
        assert isinstance(read_manifest(path), dict)


def test_the_shipped_manifest_pins_every_address() -> None:
    entries = read_manifest(MANIFEST)

    assert {"vittrack", "yolox_nano"} <= set(entries)
    for entry in entries.values():
        assert entry.licence
        assert not entry.url or entry.url.startswith("https://github.com/")
        assert "/main/" not in entry.url
        assert "/master/" not in entry.url


def test_the_mirror_beside_the_checkout_has_every_file(shared: Path, tmp_path: Path) -> None:
    names = list(read_manifest(MANIFEST))

    pulled = pull(names, shared / "models", tmp_path / "w")

    assert len(pulled) == len(names)


def test_the_command_line_lists_and_tells_what_it_could_not_pull(tmp_path: Path) -> None:
    runner = CliRunner()

    listed = runner.invoke(weights_commands, ["list", "--folder", str(tmp_path)])
    refused = runner.invoke(
        weights_commands, ["pull", "vittrack", "--mirror", str(tmp_path), "--folder", str(tmp_path)]
    )

    assert listed.exit_code == 0
    assert "vittrack" in listed.output
    assert isinstance(refused.exception, WeightsError)
    assert "expected a file vitTracker.onnx" in str(refused.exception)
