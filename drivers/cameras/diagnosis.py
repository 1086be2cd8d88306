"""Find out why a stream cannot be opened: its address in, a reason in words out.

FFmpeg tells OpenCV only that it failed. So the server is asked once, without user and password:
RTSP by DESCRIBE (RFC 2326, section 10.2), HTTP by GET (RFC 9110).
"""

import errno
import os
import re
import socket
from contextlib import closing

from drivers.cameras.address import Address
from pipeline.text import harmless

CONNECT_S = ANSWER_S = 1.0
MOST_BYTES = 4096  # of an answer
_STATUS = re.compile(rb"(?:RTSP|HTTP)/\d\.\d (\d{3})")
_TYPE = re.compile(rb"\r\ncontent-type:\s*([\w/.+-]{1,60})", re.IGNORECASE)
_WORDS = {
    errno.ECONNREFUSED: "the host refuses the connection: nothing listens on port {port}",
    errno.EHOSTUNREACH: "the host cannot be reached",
    errno.ENETUNREACH: "there is no network to the host",
    errno.ECONNRESET: "the host closed the connection",
}


def why_not(address: Address, *, timeout_s: float) -> str:
    """Return the reason in one sentence; `timeout_s` is what the failed attempt had."""
    if not address.connects:
        return f"no video arrived on port {address.port} within {timeout_s:g} s"
    if address.scheme == "tcp":  # a server of one connection would be used up by the question
        return f"no video comes from port {address.port}; does anything listen there?"
    try:
        link = socket.create_connection((address.host, address.port), CONNECT_S)
    except (socket.gaierror, UnicodeError):  # the codec idna refuses a part that is too long
        return f"there is no host of the name {harmless(address.host, 80)}"
    except TimeoutError:
        return f"the host does not answer on port {address.port} within {CONNECT_S:g} s"
    except OSError as error:
        known = _WORDS.get(error.errno or 0)
        return known.format(port=address.port) if known else _said(error)
    with closing(link):
        answer = _asked(address, link)
    return _judged(address, answer, timeout_s)


def _asked(address: Address, link: socket.socket) -> bytes:
    """The beginning of the server's answer; empty where it is silent or the link is encrypted."""
    host = f"[{address.host}]" if ":" in address.host else address.host
    place = f"{host}:{address.port}"
    if address.scheme == "rtsp":
        request = f"DESCRIBE rtsp://{place}{address.path} RTSP/1.0\r\nCSeq: 1\r\n\r\n"
    elif address.scheme == "http":
        request = f"GET {address.path} HTTP/1.0\r\nHost: {place}\r\n\r\n"
    else:
        return b""
    try:
        link.settimeout(ANSWER_S)
        link.sendall(request.encode("ascii", "replace"))
        return link.recv(MOST_BYTES)
    except OSError:
        return b""


def _judged(address: Address, answer: bytes, timeout_s: float) -> str:
    status = _STATUS.match(answer)
    if status is None:
        return f"the host answers on port {address.port}, but sends no video in {timeout_s:g} s"
    code = int(status[1])
    if code in (401, 403):
        if address.has_user:
            return f"the server refuses this user or password ({code})"
        return f"the server asks for a user and a password ({code})"
    if code in (404, 410, 454):
        return f"the server has no stream of this path ({code})"
    if code >= 400:
        return f"the server refuses with status {code}"
    if address.has_user:
        return "the server answers, but sends no video; user and password may be wrong"
    kind = _TYPE.search(answer)
    what = f" but {harmless(kind[1].decode('ascii', 'replace'))}" if kind else ""
    return f"the server answers, but sends no video that can be decoded{what}"


def _said(error: OSError) -> str:
    return harmless(os.strerror(error.errno or 0)).lower() if error.errno else "it is unreachable"
