"""Downloads: what gets its name is the whole right file, whatever server, net and disk do meanwhile."""

import hashlib
import socket
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import requests
from file_limit import no_file_may_exceed

from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.storage.download import fetch, kept_bytes

CHUNK = 512 * 1024  # bytes that gdown writes at once: less than that of a broken answer is lost
CONTENT = np.random.default_rng(0).bytes(3 * CHUNK + 1234)
OTHER = np.random.default_rng(1).bytes(len(CONTENT))
SHA256 = hashlib.sha256(CONTENT).hexdigest()
PATIENCE = 120  # seconds for what takes hardly any unless something is broken
pytestmark = pytest.mark.usefixtures("on_the_net")


@pytest.fixture
def server(server):
    """One file on the net."""
    server.serve("/net.pth", CONTENT)
    return server.files["/net.pth"]


@pytest.fixture
def to(tmp_path):
    return tmp_path / "weights" / "net.pth"


def get(url, to, timeout_seconds=PATIENCE, **stated):
    address = url if isinstance(url, str) else url.url
    fetch(address, to, timeout_seconds=timeout_seconds, pause_seconds=0.0, **stated)


def refused(url, to, message, **stated):
    """The download is refused in one line, and no file is there."""
    with pytest.raises(BadInput, match=message) as error:
        get(url, to, **stated)
    assert "\n" not in str(error.value)
    assert not to.exists()


def left_behind(to):
    """Everything beside the file but its lock."""
    return sorted(path.name for path in to.parent.iterdir() if path.name not in (to.name, f".{to.name}.lock"))


def interrupt(server, to, after_bytes=CHUNK):
    """Leave a part of `after_bytes`, as a run does that loses its server."""
    to.unlink(missing_ok=True)
    server.breaks_after, server.honours_ranges = after_bytes, False
    refused(server, to, "could not be downloaded")
    server.breaks_after, server.honours_ranges = None, True
    server.net.asked.clear()
    assert left_behind(to) == ["net.pth.part"]
    assert kept_bytes(to) == after_bytes


def test_a_file_comes_whole_and_once_with_nothing_beside_it_and_progress_rises_to_the_whole(server, to):
    heard = []
    with listening(lambda stage, done: heard.append((stage, done))):
        get(server, to, size_bytes=len(CONTENT), sha256=SHA256.upper())
    assert to.read_bytes() == CONTENT
    assert left_behind(to) == []
    shares = [done for _, done in heard]
    assert {stage for stage, _ in heard} == {"downloading net.pth"}
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0, 1)
    assert any(0.3 < share < 0.4 for share in shares)  # one chunk of a little more than three
    to.write_bytes(b"mine")
    server.net.asked.clear()
    get(server, to)
    assert to.read_bytes() == b"mine"
    assert server.net.asked == []


def test_what_a_broken_connection_has_brought_is_continued_or_comes_anew_without_ranges(server, to):
    server.breaks_after = CHUNK
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={n * CHUNK}-" for n in (1, 2, 3)]
    interrupt(server, to)
    server.honours_ranges = False
    get(server, to)
    assert to.read_bytes() == CONTENT
    to.unlink()
    server.breaks_after = 2 * CHUNK
    refused(server, to, r"\(Download")


def test_a_stalled_server_is_left_and_asked_again_and_one_that_keeps_silent_is_given_up(server, to):
    server.stalls_after = 0
    refused(server, to, r"\(.*timed", timeout_seconds=0.1)
    server.stalls_after = 2 * CHUNK
    get(server, to, sha256=SHA256, timeout_seconds=1.5)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]


def test_a_server_that_is_not_there_is_given_up_and_a_host_that_does_not_exist_at_once(to, monkeypatch):
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # and does not listen
        refused(f"http://127.0.0.1:{nobody.getsockname()[1]}/net.pth", to, "refused")

    def unknown(*_, **__):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(BadInput, match=r"cannot be reached \(Failed to resolve 'nowhere\.inv"):
        fetch("http://nowhere.invalid/file", to, pause_seconds=1000.0)


@pytest.mark.parametrize("status", [408, 429, 503])
def test_a_passing_refusal_is_waited_out_and_does_not_cost_the_part(server, to, status):
    interrupt(server, to)
    server.statuses = [status, status]
    get(server, to)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={CHUNK}-"]


@pytest.mark.parametrize("status", [403, 404])
def test_a_lasting_refusal_is_reported_at_once_and_one_that_never_passes_in_the_end(server, to, status):
    server.statuses = [status] * 9
    refused(server, to, rf"net\.pth answers {status} .* store it as .*weights.net\.pth")
    assert len(server.net.asked) == 1
    server.statuses = [500] * 9
    refused(server, to, r"could not be downloaded \(500")
    assert len(server.net.asked) == 6


def test_redirects_are_followed_when_continuing_too_within_the_web_alone(server, to):
    for target in ("/old", "file:///etc/hostname", "ftp://127.0.0.1/net.pth"):
        refused(target, to, "does not start with http")
        refused(server.net.serve("/old", location=target), to, "cannot be followed")
    server.net.asked.clear()
    server.net.serve("/newer", location=server.url)
    server.breaks_after = 2 * CHUNK
    get(server.net.serve("/old", location="/newer"), to)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]


@pytest.mark.parametrize("dated", [False, True])
def test_a_file_that_changed_meanwhile_comes_whole_in_its_new_version(server, to, dated):
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


def test_a_part_of_no_known_version_too_long_or_corrupted_is_not_kept_unless_a_hash_tells(server, to):
    interrupt(server, to, 2 * CHUNK)
    server.content = CONTENT[:CHUNK]  # under the old ETag
    get(server, to)
    assert to.read_bytes() == CONTENT[:CHUNK]
    server.content = CONTENT
    interrupt(server, to)
    part = next((to.parent / "net.pth.part").glob("*.part"))
    part.write_bytes(b"\0" + part.read_bytes()[1:])
    refused(server, to, "SHA-256", sha256=SHA256)
    server.etag = 'W/"weak"'
    interrupt(server, to)
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={CHUNK}-"]
    interrupt(server, to)
    server.content = OTHER
    get(server, to)
    assert to.read_bytes() == OTHER


@pytest.mark.parametrize(
    ("content", "stated", "message"),
    [
        (CONTENT, {"sha256": "0" * 64}, rf"gave a file with SHA-256 {SHA256}, expected {'0' * 64}: it was deleted"),
        (CONTENT, {"size_bytes": 7}, f"gave {len(CONTENT)} bytes, expected 7: it was deleted"),
        (b"\n<!DOCTYPE html><html><body>Sign in</body></html>", {}, "answers with a"),
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
    assert len(server.net.asked) == 2  # whether a part fits, and the file
    with no_file_may_exceed(CHUNK + 1000):
        refused(server, to, r"\(File.*large\): free")
    get(server, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    refused(server, tmp_path / "shared.pth" / "net.pth", "cannot be written .*: mend")


def test_google_drives_confirmation_is_passed_and_a_file_that_is_not_public_named(server, to, monkeypatch):
    request = requests.Session.request

    def elsewhere(session, method, url, **options):
        here = server.url.replace("/net.pth", "/page") if url.startswith("https://drive.google.com/") else url
        return request(session, method, here, **options)

    monkeypatch.setattr(requests.Session, "request", elsewhere)
    drive = "https://drive.google.com/uc?id=1vuz3PvnR7vxnDDLQrdHJaOA04SQrtk5L"
    page = b'<p class="uc-error-subcaption">Too many users have viewed it.</p>'
    server.net.serve("/page", page, kind="text/html; charset=utf-8")
    refused(drive, to, r"\(.*Too.*users")
    form = f'<form id="download-form" action="{server.url}"><input type="hidden" name="confirm" value="t"></form>'
    server.net.serve("/page", f"<html>{form}</html>".encode(), kind="text/html; charset=utf-8")
    server.attached, server.breaks_after = True, 2 * CHUNK
    get(drive, to, sha256=SHA256)
    assert to.read_bytes() == CONTENT
    assert server.net.ranges() == [f"bytes={2 * CHUNK}-"]
