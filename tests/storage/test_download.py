"""Downloads: what gets its name is the whole right file, whatever server, net and disk do meanwhile."""

from __future__ import annotations

import hashlib
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
import requests

from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.storage.download import fetch

CHUNK = 512 * 1024  # bytes that gdown writes at once: less than that of a broken answer is lost
CONTENT = np.random.default_rng(0).bytes(3 * CHUNK + 1234)
OTHER = np.random.default_rng(1).bytes(len(CONTENT))
SHA256 = hashlib.sha256(CONTENT).hexdigest()
PATIENCE = 120  # seconds for what takes hardly any unless something is broken
PAGE = b"\n<!DOCTYPE html><html><body>Sign in</body></html>"


@dataclass
class Asked:
    """One request and what was answered."""

    path: str
    range: str | None
    status: int = 0
    sent_bytes: int = 0
    ended: threading.Event = field(default_factory=threading.Event)


@dataclass
class Server:
    """A file on the net, and the ways in which it fails to come."""

    content: bytes = CONTENT
    etag: str | None = '"one"'
    modified: str | None = None
    kind: str = "application/octet-stream"
    attached: bool = False  # says that it is a file to keep
    honours_ranges: bool = True
    statuses: list[int] = field(default_factory=list)  # answered first, one each
    breaks_after: int | None = None  # bytes of each answer
    stalls_after: int | None = None  # bytes of each answer
    stalled: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    special: dict[str, Callable[[BaseHTTPRequestHandler], None]] = field(default_factory=dict)  # by path
    asked: list[Asked] = field(default_factory=list)
    url: str = ""

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        wanted = handler.headers.get("Range")
        asked = Asked(handler.path, wanted)
        self.asked.append(asked)
        try:
            self.answer_with(handler, asked, wanted)
        finally:
            asked.ended.set()

    def answer_with(self, handler: BaseHTTPRequestHandler, asked: Asked, wanted: str | None) -> None:
        if handler.path in self.special:
            self.special[handler.path](handler)
            return
        if self.statuses:
            handler.send_error(self.statuses.pop(0))
            return
        content, etag = self.content, self.etag
        start = int(wanted.removeprefix("bytes=").removesuffix("-")) if wanted and self.honours_ranges else 0
        if handler.headers.get("If-Range", etag or self.modified) != (etag or self.modified):
            start = 0
        asked.status = 206 if start else 200
        if start and start >= len(content):
            asked.status = 416
            content, start = b"", 0
        handler.send_response(asked.status)
        handler.send_header("Content-Type", self.kind)
        handler.send_header("Content-Length", str(len(content) - start))
        if asked.status == 206:
            handler.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        attachment = 'attachment; filename="published.ckpt"' if self.attached else None
        for name, value in (("ETag", etag), ("Last-Modified", self.modified), ("Content-Disposition", attachment)):
            if value is not None:
                handler.send_header(name, value)
        handler.end_headers()
        self.send(handler, asked, content[start:])

    def send(self, handler: BaseHTTPRequestHandler, asked: Asked, rest: bytes) -> None:
        piece = 1 << 15
        for at in range(0, len(rest), piece):
            if self.breaks_after is not None and at >= self.breaks_after:
                return
            if self.stalls_after is not None and at >= self.stalls_after:
                self.stalled.set()
                self.go_on.wait(2 * PATIENCE)
                return
            handler.wfile.write(rest[at : at + piece])
            asked.sent_bytes += len(rest[at : at + piece])

    def ranges(self) -> list[str | None]:
        """What parts were answered with, each once."""
        return list(dict.fromkeys(asked.range for asked in self.asked if asked.status == 206))


class Quiet(ThreadingHTTPServer):
    def handle_error(self, *_: Any) -> None:
        pass  # a client that goes away


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            state.answer(self)

        def log_message(self, *_: Any) -> None:
            pass

    with Quiet(("127.0.0.1", 0), Handler) as http:
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        state.url = f"http://127.0.0.1:{http.server_port}/net.pth"
        yield state
        state.go_on.set()
        http.shutdown()
        thread.join()


@pytest.fixture(autouse=True)
def no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask the servers of the tests themselves, whatever stands between this machine and the net."""
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.setenv(name, "*")


@pytest.fixture
def to(tmp_path: Path) -> Path:
    return tmp_path / "weights" / "net.pth"


def get(server: Server, to: Path, **stated: Any) -> None:
    fetch(server.url, to, timeout_seconds=PATIENCE, pause_seconds=0.0, **stated)


def left_behind(to: Path) -> list[str]:
    """Everything beside the file but its lock."""
    return sorted(path.name for path in to.parent.iterdir() if path.name not in (to.name, f".{to.name}.lock"))


def interrupt(server: Server, to: Path, after_bytes: int = CHUNK) -> None:
    """Leave a part of `after_bytes`, as a run does that loses its server."""
    server.breaks_after, server.honours_ranges = after_bytes, False
    with pytest.raises(BadInput, match="could not be downloaded"):
        get(server, to)
    server.breaks_after, server.honours_ranges = None, True
    server.asked.clear()
    assert not to.exists()
    assert left_behind(to) == ["net.pth.part"]


def test_a_file_comes_whole_with_nothing_beside_it(server: Server, to: Path) -> None:
    get(server, to, size_bytes=len(CONTENT), sha256=SHA256.upper())
    assert to.read_bytes() == CONTENT
    assert left_behind(to) == []


def test_a_file_that_is_there_is_not_asked_for(server: Server, to: Path) -> None:
    to.parent.mkdir()
    to.write_bytes(b"mine")
    get(server, to)
    assert to.read_bytes() == b"mine"
    assert server.asked == []


def test_progress_rises_to_the_whole(server: Server, to: Path) -> None:
    heard: list[tuple[str, float]] = []
    with listening(lambda stage, done: heard.append((stage, done))):
        get(server, to)
    shares = [done for _, done in heard]
    assert {stage for stage, _ in heard} == {"downloading net.pth"}
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert shares[-1] == 1
    assert any(0.3 < share < 0.4 for share in shares)  # one chunk of a little more than three


def test_what_a_broken_connection_has_brought_is_continued(server: Server, to: Path) -> None:
    server.breaks_after = CHUNK
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={n * CHUNK}-" for n in (1, 2, 3)]


def test_an_interrupted_run_is_continued_by_the_next(server: Server, to: Path) -> None:
    interrupt(server, to, 2 * CHUNK)
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_continued_download_is_sent_little_more_than_what_is_missing(server: Server, to: Path) -> None:
    server.content = CONTENT * 20  # 30 MB
    had = 57 * CHUNK
    interrupt(server, to, had)
    get(server, to)
    assert to.read_bytes() == server.content
    assert all(asked.ended.wait(PATIENCE) for asked in server.asked)
    rests = [asked.sent_bytes for asked in server.asked if asked.status == 206]
    assert max(rests) == len(server.content) - had
    whole = [asked.sent_bytes for asked in server.asked if asked.status == 200]
    assert sum(whole) < len(server.content) / 2  # answers that were closed once their headers had come


def test_a_killed_process_leaves_what_the_next_continues(server: Server, to: Path) -> None:
    server.stalls_after = 2 * CHUNK
    program = (
        "from vprbench.storage.download import *; "
        f"fetch({server.url!r}, Path({str(to)!r}), timeout_seconds={2 * PATIENCE})"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        try:
            assert server.stalled.wait(PATIENCE)
            part = to.parent / "net.pth.part"
            until = time.monotonic() + PATIENCE
            while sum(file.stat().st_size for file in part.glob("*.part")) < 2 * CHUNK and time.monotonic() < until:
                time.sleep(0.01)
        finally:
            process.kill()
    server.stalls_after = None
    server.asked.clear()
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_stalled_server_is_left_and_asked_again(server: Server, to: Path) -> None:
    server.stalls_after = 2 * CHUNK
    fetch(server.url, to, sha256=SHA256, timeout_seconds=3.0, pause_seconds=0.0)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_server_that_keeps_silent_is_given_up(server: Server, to: Path) -> None:
    server.stalls_after = 0
    with pytest.raises(BadInput, match=r"\(.*timed"):
        fetch(server.url, to, timeout_seconds=0.1, pause_seconds=0.0)
    assert not to.exists()


def test_a_server_that_is_not_there_is_given_up_in_one_line(to: Path) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and does not listen
        url = f"http://127.0.0.1:{nobody.getsockname()[1]}/net.pth"
        with pytest.raises(BadInput, match="refused") as error:
            fetch(url, to, pause_seconds=0.0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("status", [429, 500, 503])
def test_a_passing_refusal_is_waited_out(server: Server, to: Path, status: int) -> None:
    server.statuses = [status, status]
    get(server, to)
    assert to.read_bytes() == CONTENT


def test_a_passing_refusal_does_not_cost_the_part(server: Server, to: Path) -> None:
    interrupt(server, to)
    server.statuses = [503]
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={CHUNK}-"]


@pytest.mark.parametrize("status", [401, 403, 404, 410])
def test_a_lasting_refusal_is_reported_at_once(server: Server, to: Path, status: int) -> None:
    server.statuses = [status] * 9
    with pytest.raises(BadInput, match=rf"net\.pth answers {status} .* store it as .*weights.net\.pth"):
        get(server, to)
    assert len(server.asked) == 1


def redirect_to(url: str) -> Callable[[BaseHTTPRequestHandler], None]:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(302)
        handler.send_header("Location", url)
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    return answer


def test_redirects_are_followed_when_continuing_too(server: Server, to: Path) -> None:
    server.special = {"/old": redirect_to("/newer"), "/newer": redirect_to(server.url)}
    server.breaks_after = 2 * CHUNK
    fetch(server.url.replace("/net.pth", "/old"), to, pause_seconds=0.0)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={2 * CHUNK}-"]


@pytest.mark.parametrize("target", ["/old", "file:///etc/hostname", "ftp://127.0.0.1/net.pth"])
def test_a_redirect_that_leads_nowhere_is_refused(server: Server, to: Path, target: str) -> None:
    server.special = {"/old": redirect_to(target)}
    with pytest.raises(BadInput, match="cannot be followed"):
        fetch(server.url.replace("/net.pth", "/old"), to, pause_seconds=0.0)
    assert not to.exists()


@pytest.mark.parametrize("url", ["file:///etc/hostname", "ftp://127.0.0.1/net.pth", "net.pth"])
def test_only_the_web_is_downloaded_from(to: Path, url: str) -> None:
    with pytest.raises(BadInput, match="does not start with http"):
        fetch(url, to)
    assert not to.exists()


def test_a_server_without_ranges_sends_the_whole_anew(server: Server, to: Path) -> None:
    interrupt(server, to)
    server.honours_ranges = False
    get(server, to)
    assert to.read_bytes() == CONTENT


def test_a_server_without_ranges_that_always_breaks_is_given_up(server: Server, to: Path) -> None:
    server.honours_ranges, server.breaks_after = False, 2 * CHUNK
    with pytest.raises(BadInput, match=r"\(Download"):
        get(server, to)
    assert not to.exists()


@pytest.mark.parametrize("dated", [False, True])
def test_a_file_that_changed_meanwhile_comes_whole_in_its_new_version(server: Server, to: Path, dated: bool) -> None:
    if dated:
        server.etag, server.modified = None, "Wed, 21 Oct 2015 07:28:00 GMT"
    interrupt(server, to)
    server.content = OTHER
    if dated:
        server.modified = "Thu, 22 Oct 2015 07:28:00 GMT"
    else:
        server.etag = '"two"'
    get(server, to)
    assert to.read_bytes() == OTHER
    assert server.ranges() == []


def test_a_part_of_no_known_version_is_not_continued(server: Server, to: Path) -> None:
    server.etag = 'W/"weak"'
    interrupt(server, to)
    server.content = OTHER
    get(server, to)
    assert to.read_bytes() == OTHER


def test_a_part_of_no_known_version_is_continued_where_a_hash_tells(server: Server, to: Path) -> None:
    server.etag = None
    interrupt(server, to)
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.ranges() == [f"bytes={CHUNK}-"]


def test_a_part_longer_than_the_file_is_begun_anew(server: Server, to: Path) -> None:
    interrupt(server, to, 2 * CHUNK)
    server.content = CONTENT[:CHUNK]  # under the old ETag
    get(server, to)
    assert to.read_bytes() == CONTENT[:CHUNK]


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"sha256": "0" * 64}, rf"gave a file with SHA-256 {SHA256}, expected {'0' * 64}"),
        ({"size_bytes": 7}, f"gave {len(CONTENT)} bytes, expected 7"),
    ],
)
def test_another_file_than_stated_is_deleted_and_named(
    server: Server, to: Path, stated: dict[str, Any], message: str
) -> None:
    with pytest.raises(BadInput, match=rf"^{server.url} {message}: it was deleted"):
        get(server, to, **stated)
    assert not to.exists()
    assert left_behind(to) == []


def test_a_corrupted_part_is_deleted_and_the_next_run_is_right(server: Server, to: Path) -> None:
    interrupt(server, to)
    part = next((to.parent / "net.pth.part").glob("*.part"))
    part.write_bytes(b"\0" + part.read_bytes()[1:])
    with pytest.raises(BadInput, match="SHA-256"):
        get(server, to, sha256=SHA256)
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT


def test_a_web_page_is_not_taken_for_the_file(server: Server, to: Path) -> None:
    server.content, server.kind = PAGE, "text/html"
    with pytest.raises(BadInput, match="answers with a"):
        get(server, to, sha256=SHA256)
    assert not to.exists()


def test_an_empty_answer_is_not_taken_for_the_file(server: Server, to: Path) -> None:
    server.content = b""
    with pytest.raises(BadInput, match="gave 0 bytes, expected more"):
        get(server, to)
    assert not to.exists()


def test_two_processes_that_want_one_file_download_it_once(server: Server, to: Path) -> None:
    program = f"from vprbench.storage.download import *; fetch({server.url!r}, Path({str(to)!r}), sha256={SHA256!r})"
    both = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(2)]
    assert [process.wait(PATIENCE) for process in both] == [0, 0]
    assert to.read_bytes() == CONTENT
    assert len(server.asked) == 2  # whether a part fits, and the file


def test_a_full_disk_is_named_and_what_came_is_kept(server: Server, to: Path) -> None:
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (CHUNK + 1000, before[1]))
    try:
        with pytest.raises(BadInput, match=r"\(File.*large\)"):
            get(server, to)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not to.exists()
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT


def test_a_folder_that_cannot_be_made_is_named(server: Server, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BadInput, match="cannot be written"):
        get(server, tmp_path / "file" / "net.pth")


class TestGoogleDrive:
    """Its pages, as far as they matter, stand on the test's own server."""

    URL = "https://drive.google.com/uc?id=1vuz3PvnR7vxnDDLQrdHJaOA04SQrtk5L"

    @pytest.fixture(autouse=True)
    def _here(self, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
        request = requests.Session.request

        def elsewhere(session: requests.Session, method: str, url: str, **options: Any) -> requests.Response:
            here = server.url.replace("/net.pth", "/page") if url.startswith("https://drive.google.com/") else url
            return request(session, method, here, **options)

        monkeypatch.setattr(requests.Session, "request", elsewhere)

    @staticmethod
    def page(text: str) -> Callable[[BaseHTTPRequestHandler], None]:
        def answer(handler: BaseHTTPRequestHandler) -> None:
            handler.send_response(200)
            handler.send_header("Content-Type", "text/html; charset=utf-8")
            handler.send_header("Content-Length", str(len(text)))
            handler.end_headers()
            handler.wfile.write(text.encode())

        return answer

    @pytest.fixture
    def confirming(self, server: Server) -> Server:
        form = '<form id="download-form" action="{}"><input type="hidden" name="confirm" value="t"></form>'
        action = server.url.replace("/net.pth", "/file")
        server.special = {"/page": self.page(f"<html>{form.format(action)}</html>")}
        server.attached = True
        return server

    def test_the_page_that_asks_for_confirmation_is_passed(self, confirming: Server, to: Path) -> None:
        fetch(self.URL, to, sha256=SHA256, pause_seconds=0.0)
        assert to.read_bytes() == CONTENT

    def test_a_broken_download_is_continued(self, confirming: Server, to: Path) -> None:
        confirming.breaks_after = 2 * CHUNK
        fetch(self.URL, to, pause_seconds=0.0)
        assert to.read_bytes() == CONTENT
        assert confirming.ranges() == [f"bytes={2 * CHUNK}-"]

    def test_a_file_that_is_not_public_is_reported_in_one_line(self, server: Server, to: Path) -> None:
        server.special = {"/page": self.page('<p class="uc-error-subcaption">Too many users have viewed it.</p>')}
        with pytest.raises(BadInput, match=r"\(.*Too.*users") as error:
            fetch(self.URL, to, pause_seconds=0.0)
        assert "\n" not in str(error.value)
        assert not to.exists()


def test_a_host_that_does_not_exist_is_named_at_once_and_without_what_libraries_wrap_around_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*_: Any, **__: Any) -> NoReturn:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(BadInput) as caught:
        fetch("http://nowhere.invalid/file", tmp_path / "file", pause_seconds=1000.0)
    assert str(caught.value).startswith("http://nowhere.invalid/file cannot be reached (Failed to resolve 'nowhere.inv")
    assert "HTTPConnection" not in str(caught.value)
