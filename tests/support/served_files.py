"""A server of files on this machine, and the ways in which it fails to give them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

_PIECE = 1 << 15


@dataclass
class Served:
    """One file, and what happens to who asks for it."""

    content: bytes
    statuses: list[int] = field(default_factory=list)  # answered first, one each
    location: str | None = None  # where it has gone
    honours_ranges: bool = True
    breaks_after: int | None = None  # bytes of each answer
    stalls_after: int | None = None  # bytes of each answer


@dataclass
class Server:
    """Files by path, and what was asked."""

    url: str
    files: dict[str, Served] = field(default_factory=dict)
    asked: list[tuple[str, str | None]] = field(default_factory=list)  # path and range
    go_on: threading.Event = field(default_factory=threading.Event)

    def serve(self, path: str, content: bytes, **trouble: Any) -> str:
        """Put a file on the net; returns its address."""
        self.files[path] = Served(content, **trouble)
        return self.url + path

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        wanted = handler.headers.get("Range")
        self.asked.append((handler.path, wanted))
        served = self.files.get(handler.path)
        if served is None or served.statuses:
            handler.send_error(served.statuses.pop(0) if served else 404)
            return
        if served.location is not None:
            handler.send_response(302)
            handler.send_header("Location", served.location)
            handler.send_header("Content-Length", "0")
            handler.end_headers()
            return
        start = int(wanted.removeprefix("bytes=").removesuffix("-")) if wanted and served.honours_ranges else 0
        handler.send_response(206 if start else 200)
        handler.send_header("ETag", '"one"')
        handler.send_header("Content-Length", str(len(served.content) - start))
        if start:
            size = len(served.content)
            handler.send_header("Content-Range", f"bytes {start}-{size - 1}/{size}")
        handler.end_headers()
        for at in range(0, len(served.content) - start, _PIECE):
            if served.breaks_after is not None and at >= served.breaks_after:
                return
            if served.stalls_after is not None and at >= served.stalls_after:
                self.go_on.wait(120)
                return
            handler.wfile.write(served.content[start + at : start + at + _PIECE])


class _Quiet(ThreadingHTTPServer):
    def handle_error(self, *_: Any) -> None:
        pass  # a client that goes away


@contextmanager
def serving() -> Iterator[Server]:
    """Run a server while the block lasts."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            server.answer(self)

        def log_message(self, *_: Any) -> None:
            pass

    with _Quiet(("127.0.0.1", 0), Handler) as http:
        server = Server(f"http://127.0.0.1:{http.server_port}")
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.go_on.set()
            http.shutdown()
            thread.join()
