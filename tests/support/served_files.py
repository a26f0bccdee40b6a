"""A server of files on this machine, and the ways in which it fails to give them."""

import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_PIECE = 1 << 15


@dataclass
class Asked:
    """One request and the status of its answer."""

    path: str
    range: str | None
    status: int = 0


@dataclass
class Served:
    """One file, and the trouble with it."""

    content: bytes
    net: "Server"
    url: str
    kind: str = "application/octet-stream"
    statuses: list[int] = field(default_factory=list)  # answered first, one each
    honours_ranges: bool = True
    breaks_after: int | None = None  # bytes of each answer
    stalls_after: int | None = None  # bytes of each answer

    def answer(self, handler, asked):
        start = int(asked.range.removeprefix("bytes=").removesuffix("-")) if asked.range and self.honours_ranges else 0
        rest, size = self.content[start:], len(self.content)
        asked.status = 206 if start and rest else 416 if start else 200
        handler.send_response(asked.status)
        handler.send_header("Content-Type", self.kind)
        handler.send_header("Content-Length", str(len(rest)))
        if asked.status == 206:
            handler.send_header("Content-Range", f"bytes {start}-{size - 1}/{size}")
        handler.end_headers()
        for at in range(0, len(rest), _PIECE):
            if self.breaks_after is not None and at >= self.breaks_after:
                return
            if self.stalls_after is not None and at >= self.stalls_after:
                self.net.go_on.wait(240)
                return
            handler.wfile.write(rest[at : at + _PIECE])


@dataclass
class Server:
    """Files by path, and the requests for them."""

    url: str
    files: dict[str, Served] = field(default_factory=dict)
    asked: list[Asked] = field(default_factory=list)
    go_on: threading.Event = field(default_factory=threading.Event)

    def serve(self, path, content=b"", **trouble):
        """Put a file on the net; returns its address."""
        self.files[path] = Served(content, self, self.url + path, **trouble)
        return self.url + path

    def ranges(self):
        """Return the parts that were answered, each once."""
        return list(dict.fromkeys(asked.range for asked in self.asked if asked.status == 206))

    def answer(self, handler):
        asked = Asked(handler.path, handler.headers.get("Range"))
        self.asked.append(asked)
        served = self.files.get(handler.path)
        if served is None or served.statuses:
            handler.send_error(served.statuses.pop(0) if served else 404)
        else:
            served.answer(handler, asked)


class _Quiet(ThreadingHTTPServer):
    def handle_error(self, *_):
        pass  # a client that goes away


@contextmanager
def serving():
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            server.answer(self)

        def log_message(self, *_):
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
