"""A server of files on this machine, and the ways in which it fails to give them."""

import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_PIECE = 1 << 15


@dataclass
class Asked:
    """One request and what was answered."""

    path: str
    range: str | None
    status: int = 0
    sent_bytes: int = 0
    ended: threading.Event = field(default_factory=threading.Event)


@dataclass
class Served:
    """One file, and what happens to who asks for it."""

    content: bytes
    net: "Server"
    url: str
    etag: str | None = '"one"'
    modified: str | None = None
    kind: str = "application/octet-stream"
    attached: bool = False  # says that it is a file to keep
    statuses: list[int] = field(default_factory=list)  # answered first, one each
    location: str | None = None  # where it has gone
    honours_ranges: bool = True
    breaks_after: int | None = None  # bytes of each answer
    stalls_after: int | None = None  # bytes of each answer

    def answer(self, handler, asked):
        start = int(asked.range.removeprefix("bytes=").removesuffix("-")) if asked.range and self.honours_ranges else 0
        version, size = self.etag or self.modified, len(self.content)
        if handler.headers.get("If-Range", version) != version:
            start = 0
        rest = self.content[start:]
        asked.status = 302 if self.location is not None else 206 if start and rest else 416 if start else 200
        headers = {"Content-Type": self.kind, "Content-Length": str(len(rest)), "Location": self.location}
        headers |= {"ETag": self.etag, "Last-Modified": self.modified}
        headers["Content-Disposition"] = 'attachment; filename="published.ckpt"' if self.attached else None
        headers["Content-Range"] = f"bytes {start}-{size - 1}/{size}" if asked.status == 206 else None
        handler.send_response(asked.status)
        for name, value in headers.items():
            if value is not None:
                handler.send_header(name, value)
        handler.end_headers()
        for at in range(0, len(rest), _PIECE):
            if self.breaks_after is not None and at >= self.breaks_after:
                return
            if self.stalls_after is not None and at >= self.stalls_after:
                self.net.stalled.set()
                self.net.go_on.wait(240)
                return
            asked.sent_bytes += handler.wfile.write(rest[at : at + _PIECE])


@dataclass
class Server:
    """Files by path, and what was asked."""

    url: str
    files: dict[str, Served] = field(default_factory=dict)
    asked: list[Asked] = field(default_factory=list)
    stalled: threading.Event = field(default_factory=threading.Event)
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
        served = self.files.get(handler.path.partition("?")[0])
        try:
            if served is None or served.statuses:
                handler.send_error(served.statuses.pop(0) if served else 404)
            else:
                served.answer(handler, asked)
        finally:
            asked.ended.set()


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
