"""Addresses of streams: what is opened, and that no secret of it is ever shown."""

import string
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.cameras import NetworkStream, NetworkStreamSettings
from drivers.cameras.address import address, pipeline_shown, read_credentials, with_user
from drivers.cameras.diagnosis import why_not
from pipeline.errors import DriverError, SettingsError

SECRET = "Xq7-secret"
secrets = st.text(string.printable.strip(), min_size=6, max_size=20).map(lambda t: f"Xq7{t}")


@pytest.mark.parametrize(
    ("url", "shown", "place"),
    [
        ("rtsp://cam/live", "rtsp://cam/live", ("cam", 554)),
        ("rtsps://a:b@cam:7441/x?k=1", "rtsps://cam:7441/x?…", ("cam", 7441)),
        ("http://[fe80::1]:8080", "http://[fe80::1]:8080", ("fe80::1", 8080)),
        ("https://joe@cam/a%20b", "https://cam/a b", ("cam", 443)),
        ("udp://@:5000", "udp://:5000", ("", 5000)),
        ("tcp://10.0.0.9:9000", "tcp://10.0.0.9:9000", ("10.0.0.9", 9000)),
    ],
)
def test_an_address_is_taken_apart(url: str, shown: str, place: tuple[str, int]) -> None:
    found = address(url)

    assert (found.url, found.shown, (found.host, found.port)) == (url, shown, place)


@pytest.mark.parametrize(
    ("url", "said"),
    [
        (f"ftp://joe:{SECRET}@cam/", "got ftp://"),
        (f"joe:{SECRET}@cam/", "got none of them"),
        (f"{SECRET}@cam/live", "got none of them"),
        (f"rtsp://joe:{SECRET} @cam/", "expected an address without spaces"),
        (f"rtsp://joe:{SECRET}@cam:99999/", "got a broken one"),
        (f"rtsp://joe:{SECRET}@/live", "expected a host after rtsp://, got none"),
        (f"rtsp://[joe:{SECRET}@cam/live", "got a broken one"),
        (f"tcp://joe:{SECRET}@cam", "expected a port for tcp://, got none"),
    ],
)
def test_a_wrong_address_is_refused_without_repeating_it(url: str, said: str) -> None:
    with pytest.raises(SettingsError) as error:
        NetworkStreamSettings(url=url)

    assert said in str(error.value)
    assert SECRET not in str(error.value)
    assert "joe" not in str(error.value)


@settings(max_examples=40)
@given(user=secrets, password=secrets)
def test_a_user_and_a_password_of_any_letters_reach_the_server_and_nobody_else(
    user: str, password: str
) -> None:
    url = with_user("rtsp://cam:8554/live?channel=1", user, password)

    parts, found = urlsplit(url), address(url)
    assert (unquote(parts.username or ""), unquote(parts.password or "")) == (user, password)
    assert (found.host, found.port, found.path) == ("cam", 8554, "/live?channel=1")
    for said in (found.shown, repr(found)):
        assert "Xq7" not in said


def test_settings_and_summary_do_not_show_what_is_in_a_url_or_a_pipeline() -> None:
    for given_settings in (
        NetworkStreamSettings(url=f"http://joe:{SECRET}@cam/v?pwd={SECRET}"),
        NetworkStreamSettings(
            pipeline=f"rtspsrc location=rtsp://joe:{SECRET}@cam user-pw={SECRET} ! appsink"
        ),
    ):
        stream = NetworkStream(given_settings)
        assert SECRET not in repr(given_settings) + stream.source + str(stream.summary())


@pytest.mark.parametrize("host", ["cam..local", "a" * 70])
def test_a_name_that_no_host_can_have_is_told_as_one_that_is_not_there(host: str) -> None:
    said = why_not(address(f"rtsp://{host}/x"), timeout_s=1)

    assert said == f"there is no host of the name {host}"


@pytest.mark.parametrize(
    "value",
    [
        f"top!{SECRET}",
        f'"top ! {SECRET}"',
        f"'top ! {SECRET}'",
        f'"a \\" ! {SECRET} "',
        f'"not closed ! {SECRET}',
    ],
)
def test_a_password_that_holds_what_separates_elements_is_not_shown(value: str) -> None:
    shown = pipeline_shown(f"rtspsrc user-pw={value} ! decodebin ! appsink")

    assert SECRET not in shown
    assert shown.startswith("GStreamer pipeline rtspsrc")


def test_the_elements_behind_a_quoted_value_are_shown() -> None:
    shown = pipeline_shown('rtspsrc location="a ! b" ! decodebin ! appsink')

    assert shown == "GStreamer pipeline rtspsrc ! decodebin ! appsink"


@settings(max_examples=40)
@given(st.text(max_size=200))
def test_a_pipeline_is_shown_by_the_names_of_its_elements(text: str) -> None:
    shown = pipeline_shown(f"rtspsrc location={SECRET} ! {text} ! appsink")

    assert SECRET not in shown
    assert len(shown) <= 130


def test_credentials_come_from_a_file_that_only_its_owner_can_read(tmp_path: Path) -> None:
    file = tmp_path / "camera"
    file.write_text("joe:a:b@c/d\n")
    file.chmod(0o600)

    assert read_credentials(str(file)) == ("joe", "a:b@c/d")
    file.chmod(0o644)
    with pytest.raises(DriverError, match="others can read the password in it; chmod 600"):
        read_credentials(str(file))


@pytest.mark.parametrize("text", ["", SECRET, f":{SECRET}", f"joe:{SECRET}\nand more", "x" * 9999])
def test_a_file_that_holds_no_credentials_is_refused_without_repeating_it(
    tmp_path: Path, text: str
) -> None:
    file = tmp_path / "camera"
    file.write_text(text)
    file.chmod(0o600)
    with pytest.raises(DriverError, match=r"expected (one line, user:password|at most)") as error:
        read_credentials(str(file))

    assert SECRET not in str(error.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="none: cannot be read: No such file or directory"):
        read_credentials(str(tmp_path / "none"))
    with pytest.raises(DriverError, match="~nobody-here/x: cannot be read"):
        read_credentials("~nobody-here/x")
    file = tmp_path / "bytes"
    file.write_bytes(b"\xff\xfe")
    file.chmod(0o600)
    with pytest.raises(DriverError, match="expected user:password, got no text"):
        read_credentials(str(file))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, "url or pipeline: expected exactly one of them, got neither"),
        ({"url": "rtsp://a/", "pipeline": "x ! appsink"}, "got both"),
        ({"pipeline": "videotestsrc"}, "pipeline: expected an appsink at its end, got none"),
        ({"pipeline": "appsink" * 2000}, "pipeline: expected up to 8192 characters"),
        ({"pipeline": "a ! appsink", "credentials_path": "x"}, "belongs to a url"),
        ({"url": "rtsp://u@a/", "credentials_path": "x"}, "expected no user beside"),
        ({"url": "rtsp://a/", "decode_threads": 0}, "decode_threads: expected 1 to 64, got 0"),
        ({"url": "rtsp://a/", "read_timeout_s": 0}, "read_timeout_s: expected 0.05 to 3600"),
    ],
)
def test_wrong_settings_of_a_stream_are_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(SettingsError) as error:
        NetworkStreamSettings(**settings)  # type: ignore[arg-type]

    assert said in str(error.value)
