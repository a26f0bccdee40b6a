"""Fetching: a dataset gets into its folder whatever happens, or nothing changes there, and entries are complete."""

import hashlib
import json
import logging
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from archive_files import special, tarred, zipped
from checkout import SHARED
from image_folders import answer

from vprbench.data import fetch
from vprbench.data.fetch import FetchedFile, Part
from vprbench.errors import BadInput, MissingData
from vprbench.plugins import registry
from vprbench.storage.unpack import Wanted

CHUNK = 512 * 1024  # bytes that a download writes at once
NOISE = np.random.default_rng(0).bytes(3 * CHUNK)
SPRING = zipped({"spring/1.png": NOISE, "spring/2.png": b"two"})
SUMMER = tarred({"summer/1.png": b"ONE", "summer/2.png": b"TWO"})
SHA256 = hashlib.sha256(SPRING).hexdigest()
COMPLETE = ["fetched.json", "spring", "spring/1.png", "spring/2.png"]
pytestmark = pytest.mark.usefixtures("on_the_net")


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch):
    """Let gdown, which draws how long it waits, try again at once."""
    monkeypatch.setattr(random, "uniform", lambda low, high: 0.0)


def spring(*urls, **stated):
    return Part("spring.zip", urls, Wanted(unpacked_bytes=4 * CHUNK), {"spring": FetchedFile(files=2)}, **stated)


def little(*urls, **changed):
    """A little dataset of one part, unless other parts are given."""
    about = {"description": "a little journey", "licence": "CC BY 4.0", "source": "https://example.org"}
    parts = {"parts": {"spring": spring(*urls)}} if urls else {}
    return fetch.Download(
        **{"name": "little", "datasets": ("little",), "folder": "little", **about, **parts, **changed}
    )


def get(entry, root, check=None, timeout_seconds=60.0, **settings):
    given = fetch.Settings(root=None if root is None else str(root), **settings)
    return fetch.fetch(entry, given, check, timeout_seconds=timeout_seconds)


def refused(entry, root, message, kind=BadInput):
    with pytest.raises(kind, match=message):
        get(entry, root)


def visible(root):
    return sorted(str(path.relative_to(root)) for path in root.rglob("*") if not path.name.startswith("."))


def recorded(root):
    return dict(json.loads((root / "fetched.json").read_text(encoding="utf-8"))["parts"])


@pytest.fixture
def root(tmp_path):
    return tmp_path / "data" / "little"


@pytest.fixture
def url(server):
    return server.serve("/spring", SPRING)


@pytest.mark.parametrize("keep_archives", [True, False])
def test_a_dataset_is_fetched_once(server, url, tmp_path, monkeypatch, capsys, keep_archives):
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path))
    root = tmp_path / "little"  # where runs look for it
    assert get(little(url), None, keep_archives=keep_archives) == 0
    assert visible(root) == sorted([*COMPLETE, *["archives", "archives/spring.zip"] * keep_archives])
    assert (root / "spring" / "1.png").read_bytes() == NOISE
    record = recorded(root)["spring"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record.pop("fetched"))
    assert record == {"url": url, "bytes": len(SPRING), "sha256": SHA256, "licence": "CC BY 4.0"}
    printed = capsys.readouterr().out
    assert f"SHA-256 {SHA256} (none is stated" in printed
    assert f"{root / 'spring'}: 2 files\n" in printed
    server.asked.clear()
    assert get(little(url), root) == 0
    assert server.asked == []
    assert re.search(r"spring is there already, fetched on \d+-\d+-\d+\.\n.*2 files\n", capsys.readouterr().out)


def test_the_next_address_is_tried_where_a_file_is_gone_or_wrong_or_its_server_stalls(server, url, root, caplog):
    gone, stalling = f"{server.url}/gone", server.serve("/stalling", SPRING, stalls_after=0)
    other, damaged = server.serve("/other", zipped({"spring/1.png": b"another"})), server.serve("/cut", SPRING[:-CHUNK])
    for wrong, stated in ((gone, {}), (stalling, {}), (other, {"sha256": SHA256}), (damaged, {})):
        get(little(parts={"spring": spring(wrong, url, **stated)}), root, timeout_seconds=0.3)
        assert recorded(root)["spring"]["url"] == url
        assert visible(root) == COMPLETE
        shutil.rmtree(root)
    warned = [line.getMessage() for line in caplog.records if line.levelno == logging.WARNING]
    assert [line.endswith("; the next address follows") for line in warned] == [True] * 4
    assert warned[0].startswith(f"{gone} gives no file (404 ")


def test_a_person_is_told_what_to_do_where_all_fail_or_downloads_are_forbidden(server, root, monkeypatch):
    entry = little(f"{server.url}/one", f"{server.url}/two")
    by_hand = f"/two gives no file .404 .* get the file by hand and store it as {root / 'archives' / 'spring.zip'}$"
    refused(entry, root, by_hand, MissingData)
    assert [asked.path for asked in server.asked] == ["/one", "/two"]
    assert not (root / "spring").exists()
    monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
    refused(entry, root, r"VPRBENCH_OFFLINE forbids downloads: get http.*/two elsewhere and store it", MissingData)
    assert len(server.asked) == 2


def test_a_hostile_archive_or_one_of_other_folders_or_files_changes_nothing_and_is_kept(server, root, capsys):
    lines = f"{hashlib.sha256(b'one').hexdigest()}  1.png\n{hashlib.sha256(b'two').hexdigest()}  2.png\n"
    stated = {"spring": FetchedFile(sha256=hashlib.sha256(lines.encode()).hexdigest(), files=3)}
    hostile = tarred({"spring/1.png": b"one"}, [special("spring/2.png", b"2", "/etc/passwd")])
    other = zipped({"spring/2.png": b"two", "spring/1.png": b"One"})
    for content, told in (
        (hostile, r"'spring/2\.png', which is no plain file"),
        (zipped({"Spring/1.png": b"one"}), "gave no folder spring"),
        (other, "gave other files in spring than expected"),
    ):
        part = Part("spring.zip", (server.serve("/spring", content),), Wanted(unpacked_bytes=100), stated)
        refused(little(parts={"spring": part}), root, told)
        assert visible(root) == ["archives", "archives/spring.zip"]
        shutil.rmtree(root)
    server.serve("/spring", zipped({"spring/2.png": b"two", "spring/1.png": b"one"}))
    assert get(little(parts={"spring": part}), root) == 0
    assert f"{root / 'spring'}: 2 files, but 3 were expected" in capsys.readouterr().out


def test_an_archive_put_there_by_hand_needs_no_net_and_is_compared_with_what_is_stated(root, monkeypatch, capsys):
    monkeypatch.setenv("VPRBENCH_OFFLINE", "1")
    archive = root / "archives" / "spring.zip"
    archive.parent.mkdir(parents=True)
    archive.write_bytes(SUMMER)
    for stated, told in (({"sha256": SHA256}, f"SHA-256 .* stated is {SHA256}"), ({"size_bytes": 7}, "stated is 7")):
        part = spring("https://example.org/spring.zip", **stated)
        refused(little(parts={"spring": part}), root, f"{archive} has .*{told}")
    archive.write_bytes(SPRING)
    part = spring("https://example.org/spring.zip", sha256=SHA256, size_bytes=len(SPRING))
    assert get(little(parts={"spring": part}), root) == 0
    assert visible(root) == COMPLETE
    assert recorded(root)["spring"]["url"] is None
    assert f"SHA-256 {SHA256} (as stated)" in capsys.readouterr().out


def test_a_person_is_told_what_to_do_and_what_the_person_put_there_is_checked(server, url, root, capsys):
    entry = little(url, register="Register at https://example.org, and put frames/ into {folder}.\n")

    def missing(name, folder):
        raise MissingData("1.png is missing")

    assert get(little(register=entry.register), root) == 2
    assert f"Register at https://example.org, and put frames/ into {root}.\n" in capsys.readouterr().out
    assert not root.exists()
    assert get(entry, root) == 2
    assert visible(root) == COMPLETE  # the public parts
    (root / "frames").mkdir()
    assert get(entry, root, missing) == 2
    assert "1.png is missing" in capsys.readouterr().out
    gone = little(register=entry.register, parts={"lists": spring(f"{server.url}/gone")})
    shutil.rmtree(root / "spring")
    assert get(gone, root, lambda name, folder: ("2 frames, as expected",)) == 0
    assert re.search(r"/gone gives no file [^\n]*\n.*\n2 frames, as expected\n$", capsys.readouterr().out)


KNOWN = fetch.downloads()
DATA = SHARED / "data"


@pytest.mark.parametrize("entry", KNOWN.values(), ids=KNOWN)
def test_an_entry_says_what_a_person_has_to_know_and_its_parts_are_apart(entry):
    assert entry.description
    assert entry.licence
    assert entry.source.startswith("https://")
    assert set(entry.datasets) <= set(registry.find_entries("dataset"))
    parts = entry.parts.values()
    for part in parts:
        assert part.urls
        assert all(url.startswith("https://") for url in part.urls)
        assert part.file == Path(part.file).name
        assert part.holds
        assert part.sha256 is None or len(part.sha256) == 64
        assert part.about_bytes is None or part.size_bytes is None
    for names in ([part.file for part in parts], [folder for part in parts for folder in part.holds]):
        assert len({*names}) == len(names)
        assert not {"archives", "fetched.json"} & {Path(name).parts[0] for name in names}


@pytest.mark.real_frames
@pytest.mark.parametrize("folder", ["corridor/ref", "brisbane_events_7x7/sunset1"])
def test_the_stated_hash_is_that_of_the_frames(folder):
    name, _, part = folder.partition("/")
    held = KNOWN[name].parts["frames"].holds[part]
    assert (fetch.count_files(DATA / folder), fetch.hash_content(DATA / folder)) == (held.files, held.sha256)


HEAD = "# A little journey\nlicence: CC BY 4.0\nsource: https://example.org\ndatasets: []\n"
PART = """\
parts:
  all: {file: all.zip, urls: ["https://example.org/all.zip"], unpack: {unpacked_bytes: 9}, holds: {spring: {}}}
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD, "little.yaml has neither parts nor register"),
        (HEAD + PART + "seasons: 4\n", "little.yaml=.*nexpected"),
        (HEAD + PART + "default: [some]\n", "default names some, which is none of its parts"),
        (HEAD.replace("licence", "license") + PART, "little.yaml=.*"),
        ("- a list\n", "little.yaml holds no entry"),
    ],
)
def test_an_entry_is_named_and_described_by_its_file_and_a_broken_one_named_in_one_line(tmp_path, text, message):
    (tmp_path / "little.yaml").write_text(HEAD + PART)
    entry = fetch.read_entry(tmp_path / "little.yaml")
    assert (entry.name, entry.folder, entry.description) == ("little", "little", "A little journey")
    assert entry.parts["all"].unpack.strip == 0
    (tmp_path / "little.yaml").write_text(text)
    assert re.search(message, answer(fetch.read_entry, tmp_path / "little.yaml"))
