"""The live page's server: one run's directory, read-only, on this machine's loopback.

It runs in a process of its own beside the one that learns (`beside`), so that nothing a reader of the page does can
slow, stop or change the learning: the two share the run's directory and nothing else.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path as FilePath
from typing import Any

from steerkit.learning.live.snapshot import Reader

HOST = "127.0.0.1"
AT_ONCE = 16
"""Readers that are answered at the same time; others are turned away."""
PATIENCE = 5.0
"""For how long a reader may be silent, or take nothing [s]."""
EVERY = 0.5
"""The directory is read no more often than this [s]."""
NICE = 10
"""How far the server steps back behind the learning (os.nice)."""
_PAGE = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_log = logging.getLogger(__name__)


def listening(port: int) -> socket.socket:
    """A socket that listens on the loopback; raises ValueError for a port that is taken. port: 0: any free one."""
    it = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        it.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that was closed a moment ago is free
        it.bind((HOST, port))
        it.listen(32)
    except (OSError, OverflowError) as error:
        it.close()
        taken = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
        why = f"another program listens at {HOST}:{port}" if taken else f"{HOST}:{port} cannot be had ({error})"
        raise ValueError(f"--port {port}: {why}; choose another, or --port 0 for any that is free") from error
    return it


def address(it: socket.socket) -> str:
    """Where a browser finds the page."""
    return f"http://{HOST}:{it.getsockname()[1]}/"


class Server(ThreadingHTTPServer):
    """Serves the page of a run's directory on a socket that listens already; `serve_forever` until `shutdown`."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, it: socket.socket, place: FilePath):
        super().__init__(it.getsockname(), _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket = it
        self.place, self._reader, self._lock = place, Reader(place), threading.Lock()
        self._free = threading.BoundedSemaphore(AT_ONCE)
        self._body, self._at = b"", -EVERY
        page = files("steerkit.learning.live") / "page"
        self.page = {path: ((page / name).read_bytes(), kind) for path, (name, kind) in _PAGE.items()}
        port = it.getsockname()[1]
        self.names = {f"{name}:{port}" for name in (HOST, "localhost")}

    def run_now(self) -> bytes:
        """The run as JSON, not older than EVERY; `trouble` says why there is none, or none that is newer."""
        with self._lock:
            if time.monotonic() - self._at >= EVERY:
                self._body = json.dumps(self._state(), allow_nan=False).encode()
                self._at = time.monotonic()
            return self._body

    def _state(self) -> dict[str, Any]:
        if not (self.place / "run.json").exists():
            return {"trouble": f"{self.place} holds no run yet"}
        try:
            return self._reader.read()
        except (ValueError, OSError) as error:  # in the middle of a change, or broken: the next time will tell
            return {"trouble": str(error)}

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        error = sys.exception()
        if not isinstance(error, OSError):  # a reader that went away is none
            _log.warning("live page: %r", error)


class _Handler(BaseHTTPRequestHandler):
    server: Server
    server_version, sys_version = "steerkit", ""

    def setup(self) -> None:
        super().setup()
        self.connection.settimeout(PATIENCE)

    def do_GET(self) -> None:
        # a page of another site, whose name was made to point here, would send its own name
        if self.headers.get_all("Host") not in [[name] for name in self.server.names]:
            self._answer(403, b"this page is for a browser on this machine: 127.0.0.1 or localhost", "text/plain")
            return
        path = self.path.partition("?")[0]
        if path == "/run.json":
            self._answer(200, self.server.run_now(), "application/json")
        elif path in self.server.page:
            self._answer(200, *self.server.page[path])
        else:
            self._answer(404, b"there is no such page", "text/plain")

    def _refuse(self) -> None:
        self._answer(405, b"this page can only be read", "text/plain")

    do_POST = do_PUT = do_DELETE = do_PATCH = do_HEAD = do_OPTIONS = do_TRACE = do_CONNECT = _refuse

    def _answer(self, code: int, body: bytes, kind: str) -> None:
        self.send_response(code)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        if code == 405:
            self.send_header("Allow", "GET")
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Nothing: the terminal is the learner's."""


@contextlib.contextmanager
def beside(place: FilePath, *, port: int) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A server in a process of its own, as long as the block lasts and this process lives: its address, and itself.

    place: the run's directory, which may come later. Raises ValueError for a port that is taken.
    """
    with listening(port) as it:
        where, number = address(it), it.fileno()
        words = [sys.executable, "-m", "steerkit.learning.live.server", str(place), str(number)]
        process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=(number,), start_new_session=True)
    try:
        yield where, process
    finally:
        assert process.stdin is not None
        process.stdin.close()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def serve(it: socket.socket, place: FilePath) -> None:
    """Serve until Ctrl-C."""
    with Server(it, place) as server, contextlib.suppress(KeyboardInterrupt):
        server.serve_forever()


def main() -> None:
    """What `beside` starts: serve until standard input ends, as it does with the process that learns."""
    place, number = FilePath(sys.argv[1]), int(sys.argv[2])
    os.nice(NICE)
    with Server(socket.socket(fileno=number), place) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            sys.stdin.buffer.read()


if __name__ == "__main__":
    main()
