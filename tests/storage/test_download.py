"""Downloads: the file that gets its name is the whole right one, whatever server, net and disk do meanwhile."""

import hashlib
import random
import socket
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from file_limit import no_file_may_exceed

from vprbench.errors import BadInput
from vprbench.progress import send_reports_to
from vprbench.storage.download import fetch

CHUNK = 512 * 1024  # bytes that gdown writes at once: less than that of a broken answer is lost
CONTENT = np.random.default_rng(0).bytes(3 * CHUNK + 1234)
OTHER = np.random.default_rng(1).bytes(len(CONTENT))
SHA256 = hashlib.sha256(CONTENT).hexdigest()
PATIENCE = 120  # seconds for an answer that takes hardly any unless something is broken
pytestmark = pytest.mark.usefixtures("on_the_net")


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch):
    """Let gdown, which draws how long it waits, try again at once."""
    monkeypatch.setattr(random, "uniform", lambda low, high: 0.0)


@pytest.fixture
def server(server):
    """One file on the net."""
    server.serve("/net.pth", CONTENT)
    return server.files["/net.pth"]


@pytest.fixture
def to(tmp_path):
    return tmp_path / "weights" / "net.pth"


def get(url, to, timeout_seconds=PATIENCE, **stated):
    fetch(url if isinstance(url, str) else url.url, to, timeout_seconds=timeout_seconds, **stated)


def refused(url, to, message, **stated):
    """The download is refused in one line, and no file is there."""
    with pytest.raises(BadInput, match=message) as error:
        get(url, to, **stated)
    assert "\n" not in str(error.value)
    assert not to.exists()


def left_behind(to):
    """Return the sizes of the parts beside a file."""
    return [part.stat().st_size for part in to.parent.glob("*.part/*")]


def interrupt(server, to):
    """Leave a part of one chunk, as Ctrl-C does."""

    def stop(stage, done):
        if done:
            raise KeyboardInterrupt

    to.unlink(missing_ok=True)
    with send_reports_to(stop), pytest.raises(KeyboardInterrupt):
        get(server, to)
    server.net.asked.clear()
    assert left_behind(to) == [CHUNK]


def test_a_file_comes_whole_and_once_with_nothing_beside_it_and_progress_rises_to_the_whole(server, to):
    heard = []
    with send_reports_to(lambda stage, done: heard.append((stage, done))):
        get(server, to, size_bytes=len(CONTENT), sha256=SHA256.upper())
    assert to.read_bytes() == CONTENT
    assert sorted(path.name for path in to.parent.iterdir()) == [".net.pth.lock", "net.pth"]
    shares = [min(n * CHUNK / len(CONTENT), 1) for n in range(5)]
    assert heard == [("downloading net.pth", share) for share in shares]
    to.write_bytes(b"mine")
    server.net.asked.clear()
    get(server, to)
    assert to.read_bytes() == b"mine"
    assert server.net.asked == []


def test_a_broken_connection_is_continued_and_so_is_the_part_of_an_earlier_call(server, to):
    server.breaks_after = CHUNK
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={n * CHUNK}-" for n in (1, 2, 3)]
    server.breaks_after = None
    interrupt(server, to)
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={CHUNK}-"]


@pytest.mark.parametrize("trouble", ["no ranges", "another file", "another file, no resuming"])
def test_a_part_that_cannot_be_continued_comes_anew_at_the_latest_at_the_next_call(server, to, trouble):
    interrupt(server, to)
    server.honours_ranges = trouble != "no ranges"
    server.content = CONTENT if trouble == "no ranges" else OTHER
    stated = {"sha256": hashlib.sha256(server.content).hexdigest(), "resume": trouble != "another file, no resuming"}
    if stated["resume"]:
        refused(server, to, "did not honor|SHA-256", **stated)
    get(server, to, **stated)
    assert to.read_bytes() == server.content


def test_a_stalled_server_is_asked_again_and_a_silent_one_is_given_up(server, to):
    server.stalls_after = 0
    refused(server, to, r"\(.*timed", timeout_seconds=0.1)
    server.stalls_after = 2 * CHUNK
    get(server, to, sha256=SHA256, timeout_seconds=1.5)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_server_that_is_not_there_or_refuses_costs_no_part(server, to):
    interrupt(server, to)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and does not listen
        refused(f"http://127.0.0.1:{nobody.getsockname()[1]}/net.pth", to, "gives no file .*refused")
    refused("file:///etc/hostname", to, "gives no file")
    server.statuses = [404]
    refused(server, to, r"net\.pth gives no file \(404 .* store it as .*weights.net\.pth")
    assert len(server.net.asked) == 1
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={CHUNK}-"]


@pytest.mark.parametrize(
    ("content", "stated", "message"),
    [
        (CONTENT, {"sha256": "0" * 64}, rf"gave a file with SHA-256 {SHA256}, expected {'0' * 64}"),
        (CONTENT, {"size_bytes": 7}, f"gave {len(CONTENT)} bytes, expected 7"),
        (b"\n<!DOCTYPE html><html><body>Sign in</body></html>", {}, "gave a web page"),
        (b"", {}, "gave 0 bytes, expected more"),
    ],
)
def test_another_file_than_stated_a_web_page_or_nothing_is_deleted_and_named(server, to, content, stated, message):
    server.content, server.kind = content, "text/html"
    refused(server, to, rf"^{server.url} {message}", **stated)
    assert left_behind(to) == []


def test_a_full_disk_or_no_folder_is_named_and_two_that_want_one_file_download_it_once(server, to, tmp_path):
    with ThreadPoolExecutor(2) as threads:
        [*threads.map(lambda _: get(server, tmp_path / "shared.pth", sha256=SHA256), range(2))]
    assert (tmp_path / "shared.pth").read_bytes() == CONTENT
    assert len(server.net.asked) == 1
    with no_file_may_exceed(CHUNK + 1000):
        refused(server, to, r"cannot be written \(File.*large\): free")
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    refused(server, tmp_path / "shared.pth" / "net.pth", "cannot be written")
