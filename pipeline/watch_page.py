"""Local page of a watched campaign: served to this machine alone, and read only."""

from __future__ import annotations

import errno
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from truing.pipeline.problems import EnvironmentProblem
from truing.report.watching import SECONDS_BETWEEN_LOOKS, Watched, watch_page
from truing.schemas.artifacts import ARTIFACTS

_HOST, _PORT = "127.0.0.1", 8765
_NAMES = ("127.0.0.1", "localhost")
_NOTHING_YET = watch_page(None, has_report=False)


class WatchServer(ThreadingHTTPServer):
    """Serves three answers: the page of the last round, its number, and the report of the run.

    Paths of requests are compared with these names, and never become paths of files.
    """

    daemon_threads = True

    def __init__(self, port: int) -> None:
        super().__init__((_HOST, port), _Handler)
        self._page, self._number, self._report = _NOTHING_YET, 0, Path()
        self._has_reader, self._is_read = False, threading.Event()

    @property
    def address(self) -> str:
        """Address for the browser."""
        return f"http://{_HOST}:{self.server_address[1]}/"

    def show(self, state: Watched, run: Path | None) -> None:
        """Replace the page by that of another round."""
        report = Path() if run is None else run / ARTIFACTS["report"].file
        self._page, self._report = watch_page(state, has_report=report.is_file()), report
        self._number = state.number
        self._is_read.clear()

    def mark_asked(self) -> int:
        """Remember that a browser asks for the page; returns the number of the round that it will have."""
        self._has_reader = True
        return self._number

    def mark_read(self, number: int) -> None:
        """Remember that a browser has the page of a round; another round may have replaced it meanwhile."""
        if number == self._number:
            self._is_read.set()

    def wait_for_reader(self) -> None:
        """Wait until an open page has loaded the last round, for as long as two of its looks take."""
        if self._has_reader:
            self._is_read.wait(2.0 * SECONDS_BETWEEN_LOOKS)

    def answer(self, path: str) -> tuple[str, bytes] | None:
        """Type and content of an answer; None for any other path."""
        if path == "/":
            return "text/html; charset=utf-8", self._page.encode()
        if path == "/round":
            return "text/plain; charset=utf-8", str(self._number).encode()
        if path == "/report.html" and not self._report.is_symlink():  # a link could lead out of the run
            try:
                return "text/html; charset=utf-8", self._report.read_bytes()
            except OSError:  # there is none
                return None
        return None

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing about a browser that leaves before it has its answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: WatchServer

    def do_GET(self) -> None:
        self._send(with_body=True)

    def do_HEAD(self) -> None:
        self._send(with_body=False)

    def _send(self, *, with_body: bool) -> None:
        """Answer requests that name this machine; a page of another origin cannot read them under its own name."""
        if (self.headers.get("Host") or "").rsplit(":", 1)[0] not in _NAMES:
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        is_page = with_body and self.path == "/"
        number = self.server.mark_asked() if is_page else 0
        found = self.server.answer(self.path)
        if found is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        kind, content = found
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if with_body:
            self.wfile.write(content)
        if is_page:
            self.server.mark_read(number)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing about requests."""


@contextmanager
def serving(port: int | None) -> Iterator[WatchServer]:
    """Serve on a port until the end of the context; without one on the usual port, or on any if that is taken.

    Raises EnvironmentProblem if the given port cannot be used.
    """
    server = _server(port)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()


def _server(port: int | None) -> WatchServer:
    try:
        return WatchServer(_PORT if port is None else port)
    except OSError as error:
        if port is None:
            return WatchServer(0)
        why = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be used ({error.strerror})"
        raise EnvironmentProblem(f"port {port} {why}: give another one with --port, or --no-page") from None
