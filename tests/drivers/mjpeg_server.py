"""A camera that serves multipart MJPEG over HTTP, as IP cameras do; knows none of our code."""

import base64
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2

from tests.drivers.numbered import picture

BOUNDARY = "frame"


class MjpegServer:
    """Serves frames 0, 1, 2 … at a rate to all clients; `stop` closes their connections."""

    def __init__(
        self,
        *,
        port: int = 0,
        rate_hz: float = 50.0,
        first: int = 0,
        size_px: tuple[int, int] = (320, 192),
        user: str = "",
        frames: int = 0,  # then the stream ends; 0: never
        grey: bool = False,
    ) -> None:
        self.rate_hz, self.size_px, self.user, self.frames = rate_hz, size_px, user, frames
        self.grey = grey
        self.silent = threading.Event()  # set: connected, but nothing is sent
        self.broken = threading.Event()  # set: parts that are no JPEG
        self.stopping = threading.Event()
        self.sent = first  # number of the next frame
        self.clients = 0
        self._guard = threading.Lock()
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                server.answer(self)

            def log_message(self, *_: object) -> None:
                pass

        class Quiet(ThreadingHTTPServer):
            allow_reuse_address = True
            daemon_threads = True

            def handle_error(self, *_: object) -> None:
                pass  # a client that went away

        self._http = Quiet(("127.0.0.1", port), Handler)
        self.port = int(self._http.server_address[1])
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.01,), daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/stream"

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        wanted = "Basic " + base64.b64encode(self.user.encode()).decode()
        if self.user and request.headers.get("Authorization") != wanted:
            request.send_response(401)
            request.send_header("WWW-Authenticate", 'Basic realm="camera"')
            request.end_headers()
            return
        if not request.path.startswith("/stream"):
            request.send_error(404)
            return
        with self._guard:
            self.clients += 1
        request.send_response(200)
        request.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        request.end_headers()
        begun, made = time.monotonic(), 0
        while not self.stopping.is_set() and (not self.frames or made < self.frames):
            if not self.silent.is_set():
                request.wfile.write(self._part())
                request.wfile.flush()
            made += 1
            self.stopping.wait(max(0.0, begun + made / self.rate_hz - time.monotonic()))

    def _part(self) -> bytes:
        with self._guard:
            shown = picture(self.sent, self.size_px)
            self.sent += 1
        code = cv2.COLOR_RGB2GRAY if self.grey else cv2.COLOR_RGB2BGR
        jpeg = cv2.imencode(".jpg", cv2.cvtColor(shown, code))[1].tobytes()
        if self.broken.is_set():
            jpeg = b"\xff\xd8 no picture \xff\xd9"
        head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
        return head.encode() + jpeg + b"\r\n"

    def stop(self) -> None:
        """End all streams and listen no more; the port is free then."""
        self.stopping.set()
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()
