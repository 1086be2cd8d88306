"""A page in a headless Chromium, by its debugging pipe: open, wait until it is drawn, photograph.

The browser draws by software, so that no display and no GPU are needed.
"""

import base64
import json
import os
import select
import shutil
import tempfile
import time
from collections.abc import Callable
from io import BytesIO
from subprocess import DEVNULL, Popen
from typing import Any

from PIL import Image

from pipeline.errors import RunError

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--headless=new", "--no-sandbox", "--hide-scrollbars", "--no-first-run",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    "--remote-debugging-pipe",
)  # fmt: skip
ANSWER_S = 60.0  # for one command
MOST_BYTES = 1 << 26  # of one answer
LEAST_BYTES = 120_000  # of a picture with something on it
SETTLE_S = 8.0  # between two looks; drawing by software takes seconds
BAR_PX = 36  # at the top, where a figure changes for ever


def browser() -> str:
    """Return the path of a Chromium; raises `RunError` when there is none."""
    found = [path for name in NAMES if (path := shutil.which(name))]
    if not found:
        raise RunError(f"expected one of {', '.join(NAMES)} to be installed, got none")
    return found[0]


def has_content(png: bytes) -> bool:
    """Return whether a picture is larger than that of an empty page."""
    return len(png) > LEAST_BYTES


class Page:
    """One page of a browser of its own, which ends with the context."""

    def __init__(self, url: str, size_px: tuple[int, int]) -> None:
        self._url, self._size_px = url, size_px
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._number, self._rest = 0, b""

    def __enter__(self) -> "Page":
        there_read, self._write = os.pipe()
        self._read, there_write = os.pipe()
        size = ",".join(map(str, self._size_px))
        words = [browser(), *OPTIONS, f"--user-data-dir={self._folder.name}"]
        # the browser reads descriptor 3 and writes 4
        shell = 'from=$1 to=$2; shift 2; exec "$@" 3<&"$from" 4>&"$to"'
        ends = (there_read, there_write)
        self._process = Popen(
            ["bash", "-c", shell, "bash", *map(str, ends), *words, f"--window-size={size}"],
            pass_fds=ends, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL,
        )  # fmt: skip
        os.close(there_read)
        os.close(there_write)
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        width, height = self._size_px
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        self.ask("Emulation.setEmulatedMedia", features=dark)
        self.ask("Page.navigate", url=self._url)
        return self

    def click(self, x_px: int, y_px: int) -> None:
        """Click at a place of the page."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = "none" if kind == "mouseMoved" else "left"
            self.ask(
                "Input.dispatchMouseEvent", type=kind, x=x_px, y=y_px, button=button, clickCount=1
            )

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._read)
        os.close(self._write)
        self._folder.cleanup()

    _session = ""

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol; raises `RunError` for an error or a timeout."""
        self._number += 1
        order: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            order["sessionId"] = self._session
        os.write(self._write, json.dumps(order).encode() + b"\0")
        late_s = time.monotonic() + ANSWER_S
        while True:
            answer = self._next(method, late_s)
            if answer.get("id") != self._number:
                continue  # an event
            if "error" in answer:
                raise RunError(f"chromium: {method}: {answer['error'].get('message', '')[:200]}")
            found: dict[str, Any] = answer["result"]
            return found

    def photograph(self) -> bytes:
        """Return what is on the page now, as PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])

    def drawn(self, timeout_s: float, there: Callable[[bytes], bool] = has_content) -> bytes:
        """Return a PNG of the page once nothing changes between looks, or at the timeout.

        `there` says whether a PNG has on it what is waited for. Raises `RunError` when it has not
        at the timeout.
        """
        late_s, before = time.monotonic() + timeout_s, b""
        while time.monotonic() < late_s:
            time.sleep(SETTLE_S)
            now = self.photograph()
            if there(now) and before and below_bar(now) == below_bar(before):
                break
            before = now
        if before and there(before):
            return before
        raise RunError(f"chromium: {self._url} was not drawn within {timeout_s:.0f} s")

    def _next(self, method: str, late_s: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            left_s = late_s - time.monotonic()
            if left_s <= 0 or not select.select([self._read], [], [], left_s)[0]:
                raise RunError(f"chromium: {method}: no answer within {ANSWER_S:.0f} s")
            piece = os.read(self._read, 1 << 20)
            if not piece or len(self._rest) > MOST_BYTES:
                raise RunError(f"chromium: {method}: the browser ended")
            self._rest += piece
        text, _, self._rest = self._rest.partition(b"\0")
        found: dict[str, Any] = json.loads(text)
        return found


def below_bar(png: bytes) -> bytes:
    """Return the pixels of a picture below its uppermost `BAR_PX`."""
    picture = Image.open(BytesIO(png)).convert("RGB")
    return picture.crop((0, BAR_PX, *picture.size)).tobytes()
