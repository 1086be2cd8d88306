"""Addresses of network streams: a URL in, what to open and what may be shown out.

What may be shown has no user, no password and no values of a query, since some cameras take their
password there.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import SplitResult, quote, unquote, urlsplit

from drivers.regular_file import contents, opened
from pipeline.errors import DriverError, SettingsError
from pipeline.text import harmless

PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443, "tcp": 0, "udp": 0}
LISTENING = ("udp",)  # nobody to connect to: packets arrive or not
MOST_CHARS = 120  # of an address in a message
MOST_BYTES = 4096  # of a file with a user and a password
_QUOTED = re.compile(r"""(["'])(?:\\.|(?!\1)[^\\])*(?:\1|\\?$)""", re.DOTALL)  # or not closed
_LINK = re.compile(r"(?:^|(?<=\s))!(?=\s|$)")  # `!` within a word belongs to a value


@dataclass(frozen=True, kw_only=True)
class Address:
    """One stream. Its `repr` and `shown` tell no secrets; `url` has them all."""

    url: str = field(repr=False)
    shown: str
    scheme: str
    host: str
    port: int
    path: str = field(repr=False)  # with the query, as a request sends it
    has_user: bool = False

    @property
    def connects(self) -> bool:
        """Whether there is a server to connect to."""
        return self.scheme not in LISTENING


def address(url: str) -> Address:
    """Take a URL apart; raises `SettingsError`, which does not repeat it."""
    if not url.isprintable() or " " in url:
        raise SettingsError("url: expected an address without spaces, got one with spaces in it")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise SettingsError("url: expected scheme://host:port/path, got a broken one") from error
    if parts.scheme not in PORTS:
        # without the slashes, what stands before the colon may be the name of a user
        known = re.fullmatch(r"[a-z][a-z0-9+.-]{0,15}", parts.scheme) and parts.netloc
        got = f"{parts.scheme}://" if known else "none of them"
        raise SettingsError(f"url: expected {'://, '.join(PORTS)}:// and an address, got {got}")
    if parts.scheme not in LISTENING and not parts.hostname:
        raise SettingsError(f"url: expected a host after {parts.scheme}://, got none")
    if not (port or PORTS[parts.scheme]):
        raise SettingsError(f"url: expected a port for {parts.scheme}://, got none")
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return Address(
        url=url,
        shown=_shown(parts),
        scheme=parts.scheme,
        host=parts.hostname or "",
        port=port or PORTS[parts.scheme],
        path=path,
        has_user=parts.username is not None,
    )


def with_user(url: str, user: str, password: str) -> str:
    """The URL with a user and a password, escaped as a URL needs it."""
    parts = urlsplit(url)
    place = parts.netloc.rpartition("@")[2]
    who = f"{quote(user, safe='')}:{quote(password, safe='')}"
    return parts._replace(netloc=f"{who}@{place}").geturl()


def read_credentials(path: str) -> tuple[str, str]:
    """User and password from a file of one line, `user:password`, that only its owner can read.

    Raises `DriverError` that names the file and never what is in it.
    """
    try:
        place = Path(path).expanduser()
    except RuntimeError as error:  # the home of a user that does not exist
        raise DriverError(f"{path}: cannot be read: {error}") from error
    with opened(place, MOST_BYTES) as file:
        if os.fstat(file.fileno()).st_mode & 0o077:
            raise DriverError(f"{path}: others can read the password in it; chmod 600 {path}")
        data = contents(place, file, MOST_BYTES)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise DriverError(f"{path}: expected user:password, got no text") from error
    lines = text.strip().splitlines()
    user, colon, password = lines[0].partition(":") if len(lines) == 1 else ("", "", "")
    if not (user and colon):
        raise DriverError(f"{path}: expected one line, user:password, got something else")
    return user, password


def pipeline_shown(pipeline: str) -> str:
    """The elements of a GStreamer pipeline without their properties.

    >>> pipeline_shown("rtspsrc location=rtsp://a:b@c user-pw=x ! decodebin ! appsink")
    'GStreamer pipeline rtspsrc ! decodebin ! appsink'
    """
    bare = _QUOTED.sub("…", pipeline)  # a value may hold what separates elements
    elements = [words[0] for part in _LINK.split(bare) if (words := part.split())]
    named = [name if re.fullmatch(r"[\w-]+", name) else "…" for name in elements]
    return harmless(f"GStreamer pipeline {' ! '.join(named)}", MOST_CHARS)


def _shown(parts: SplitResult) -> str:
    place = parts.netloc.rpartition("@")[2]
    query = "?…" if parts.query else ""
    return harmless(f"{parts.scheme}://{place}{unquote(parts.path)}{query}", MOST_CHARS)
