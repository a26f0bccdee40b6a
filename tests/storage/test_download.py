"""Downloads: what gets its name is the whole right file, whatever server, net and disk do meanwhile."""

from __future__ import annotations

import hashlib
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
import requests
from file_limit import no_file_may_exceed
from served_files import Served, serving

from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.storage.download import fetch

CHUNK = 512 * 1024  # bytes that gdown writes at once: less than that of a broken answer is lost
CONTENT = np.random.default_rng(0).bytes(3 * CHUNK + 1234)
OTHER = np.random.default_rng(1).bytes(len(CONTENT))
SHA256 = hashlib.sha256(CONTENT).hexdigest()
PATIENCE = 120  # seconds for what takes hardly any unless something is broken
pytestmark = pytest.mark.usefixtures("on_the_net")
PAGE = b"\n<!DOCTYPE html><html><body>Sign in</body></html>"


@pytest.fixture
def server() -> Iterator[Served]:
    """One file on the net."""
    with serving() as net:
        net.serve("/net.pth", CONTENT)
        yield net.files["/net.pth"]


@pytest.fixture
def to(tmp_path: Path) -> Path:
    return tmp_path / "weights" / "net.pth"


def get(server: Served, to: Path, **stated: Any) -> None:
    fetch(server.url, to, timeout_seconds=PATIENCE, pause_seconds=0.0, **stated)


def left_behind(to: Path) -> list[str]:
    """Everything beside the file but its lock."""
    return sorted(path.name for path in to.parent.iterdir() if path.name not in (to.name, f".{to.name}.lock"))


def interrupt(server: Served, to: Path, after_bytes: int = CHUNK) -> None:
    """Leave a part of `after_bytes`, as a run does that loses its server."""
    server.breaks_after, server.honours_ranges = after_bytes, False
    with pytest.raises(BadInput, match="could not be downloaded"):
        get(server, to)
    server.breaks_after, server.honours_ranges = None, True
    server.net.asked.clear()
    assert not to.exists()
    assert left_behind(to) == ["net.pth.part"]


def test_a_file_comes_whole_and_once_with_nothing_beside_it(server: Served, to: Path) -> None:
    get(server, to, size_bytes=len(CONTENT), sha256=SHA256.upper())
    assert to.read_bytes() == CONTENT
    assert left_behind(to) == []
    to.write_bytes(b"mine")
    server.net.asked.clear()
    get(server, to)
    assert to.read_bytes() == b"mine"
    assert server.net.asked == []


def test_a_broken_connection_is_continued_and_progress_rises_to_the_whole(server: Served, to: Path) -> None:
    heard: list[tuple[str, float]] = []
    server.breaks_after = CHUNK
    with listening(lambda stage, done: heard.append((stage, done))):
        get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={n * CHUNK}-" for n in (1, 2, 3)]
    shares = [done for _, done in heard]
    assert {stage for stage, _ in heard} == {"downloading net.pth"}
    assert (shares, shares[0], shares[-1]) == (sorted(shares), 0, 1)
    assert any(0.3 < share < 0.4 for share in shares)  # one chunk of a little more than three


def test_a_killed_process_leaves_what_the_next_continues(server: Served, to: Path) -> None:
    server.stalls_after = 2 * CHUNK
    program = (
        "from vprbench.storage.download import *; "
        f"fetch({server.url!r}, Path({str(to)!r}), timeout_seconds={2 * PATIENCE})"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        try:
            assert server.net.stalled.wait(PATIENCE)
            part = to.parent / "net.pth.part"
            until = time.monotonic() + PATIENCE
            while sum(file.stat().st_size for file in part.glob("*.part")) < 2 * CHUNK and time.monotonic() < until:
                time.sleep(0.01)
        finally:
            process.kill()
    server.stalls_after = None
    server.net.asked.clear()
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_stalled_server_is_left_and_asked_again(server: Served, to: Path) -> None:
    server.stalls_after = 2 * CHUNK
    fetch(server.url, to, sha256=SHA256, timeout_seconds=3.0, pause_seconds=0.0)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_server_that_keeps_silent_or_is_not_there_is_given_up_in_one_line(server: Served, to: Path) -> None:
    server.stalls_after = 0
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and does not listen
        absent = f"http://127.0.0.1:{nobody.getsockname()[1]}/net.pth"
        for url in (server.url, absent):
            with pytest.raises(BadInput) as error:
                fetch(url, to, timeout_seconds=0.1, pause_seconds=0.0)
            assert url in str(error.value)
            assert "\n" not in str(error.value)
    assert not to.exists()


@pytest.mark.parametrize("status", [429, 503])
def test_a_passing_refusal_is_waited_out_and_does_not_cost_the_part(server: Served, to: Path, status: int) -> None:
    interrupt(server, to)
    server.statuses = [status, status]
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={CHUNK}-"]


@pytest.mark.parametrize("status", [401, 404])
def test_a_lasting_refusal_is_reported_at_once(server: Served, to: Path, status: int) -> None:
    server.statuses = [status] * 9
    with pytest.raises(BadInput, match=rf"net\.pth answers {status} "):
        get(server, to)
    assert len(server.net.asked) == 1


@pytest.mark.parametrize("target", ["/old", "file:///etc/hostname", "ftp://127.0.0.1/net.pth"])
def test_redirects_within_the_web_alone_are_followed(server: Served, to: Path, target: str) -> None:
    for url in (target, server.net.serve("/old", location=target)):
        with pytest.raises(BadInput):
            fetch(url, to, pause_seconds=0.0)
    assert not to.exists()
    server.breaks_after = 2 * CHUNK
    fetch(server.net.serve("/older", location=server.url), to, pause_seconds=0.0)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_server_without_ranges_sends_the_whole_anew_and_is_given_up_if_it_always_breaks(
    server: Served, to: Path
) -> None:
    interrupt(server, to)
    server.honours_ranges = False
    server.breaks_after = 2 * CHUNK
    with pytest.raises(BadInput):
        get(server, to)
    assert not to.exists()
    server.breaks_after = None
    get(server, to)
    assert to.read_bytes() == CONTENT


@pytest.mark.parametrize("dated", [False, True])
def test_a_file_that_changed_meanwhile_comes_whole_in_its_new_version(server: Served, to: Path, dated: bool) -> None:
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
    assert server.net.ranges() == []


def test_a_part_of_no_known_version_is_continued_only_where_a_hash_tells(server: Served, to: Path) -> None:
    server.etag = 'W/"weak"'
    interrupt(server, to)
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={CHUNK}-"]
    to.unlink()
    interrupt(server, to)
    server.content = OTHER
    get(server, to)
    assert to.read_bytes() == OTHER


def test_a_part_longer_than_the_file_is_begun_anew(server: Served, to: Path) -> None:
    interrupt(server, to, 2 * CHUNK)
    server.content = CONTENT[:CHUNK]  # under the old ETag
    get(server, to)
    assert to.read_bytes() == CONTENT[:CHUNK]


@pytest.mark.parametrize(("stated", "found"), [({"sha256": "0" * 64}, SHA256), ({"size_bytes": 7}, str(len(CONTENT)))])
def test_another_file_than_stated_is_deleted_and_named(
    server: Served, to: Path, stated: dict[str, Any], found: str
) -> None:
    with pytest.raises(BadInput, match=f"{server.url} .*{found}"):
        get(server, to, **stated)
    assert not to.exists()
    assert left_behind(to) == []


def test_a_corrupted_part_is_deleted_and_the_next_run_is_right(server: Served, to: Path) -> None:
    interrupt(server, to)
    part = next((to.parent / "net.pth.part").glob("*.part"))
    part.write_bytes(b"\0" + part.read_bytes()[1:])
    with pytest.raises(BadInput, match="SHA-256"):
        get(server, to, sha256=SHA256)
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT


@pytest.mark.parametrize("content", [PAGE, b""])
def test_a_web_page_or_nothing_is_not_taken_for_the_file(server: Served, to: Path, content: bytes) -> None:
    server.content, server.kind = content, "text/html"
    with pytest.raises(BadInput):
        get(server, to)
    assert not to.exists()


def test_two_processes_that_want_one_file_download_it_once(server: Served, to: Path) -> None:
    program = f"from vprbench.storage.download import *; fetch({server.url!r}, Path({str(to)!r}), sha256={SHA256!r})"
    both = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(2)]
    assert [process.wait(PATIENCE) for process in both] == [0, 0]
    assert to.read_bytes() == CONTENT
    assert len(server.net.asked) == 2  # whether a part fits, and the file


def test_a_full_disk_is_named_and_what_came_is_kept(server: Served, to: Path) -> None:
    with no_file_may_exceed(CHUNK + 1000), pytest.raises(BadInput, match=r"\(File.*large\)"):
        get(server, to)
    assert not to.exists()
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    with pytest.raises(BadInput, match=str(to)):
        get(server, to / "net.pth")  # below a file no folder can be made


class TestGoogleDrive:
    """Its pages, as far as they matter, stand on the test's own server."""

    URL = "https://drive.google.com/uc?id=1vuz3PvnR7vxnDDLQrdHJaOA04SQrtk5L"

    @pytest.fixture(autouse=True)
    def _here(self, server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
        request = requests.Session.request

        def elsewhere(session: requests.Session, method: str, url: str, **options: Any) -> requests.Response:
            here = server.url.replace("/net.pth", "/page") if url.startswith("https://drive.google.com/") else url
            return request(session, method, here, **options)

        monkeypatch.setattr(requests.Session, "request", elsewhere)

    @pytest.fixture
    def confirming(self, server: Served) -> Served:
        form = '<form id="download-form" action="{}"><input type="hidden" name="confirm" value="t"></form>'
        server.net.serve("/page", f"<html>{form.format(server.url)}</html>".encode(), kind="text/html; charset=utf-8")
        server.attached = True
        return server

    @pytest.mark.parametrize("breaks_after", [None, 2 * CHUNK])
    def test_the_page_that_asks_for_confirmation_is_passed_when_continuing_too(
        self, confirming: Served, to: Path, breaks_after: int | None
    ) -> None:
        confirming.breaks_after = breaks_after
        fetch(self.URL, to, sha256=SHA256, pause_seconds=0.0)
        assert to.read_bytes() == CONTENT
        assert confirming.net.ranges() == ([f"bytes={breaks_after}-"] if breaks_after else [])

    def test_a_file_that_is_not_public_is_reported_in_one_line(self, server: Served, to: Path) -> None:
        page = b'<p class="uc-error-subcaption">Too many users have viewed it.</p>'
        server.net.serve("/page", page, kind="text/html; charset=utf-8")
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
