"""Hashes of files are right whatever happens to them, and computed once; a cache without a home asks for it."""

import hashlib
import os
import pwd
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import platformdirs
import pytest

from vprbench.api.weights import weights_folder
from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.storage import hashes
from vprbench.storage.folders import cache_folder
from vprbench.storage.hashes import file_hashes, hashes_folder

EMPTY = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"  # of the standard, FIPS 180-4
ABC = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@pytest.fixture
def read(monkeypatch):
    """How often each file was read, by name."""
    counts = Counter()
    digest = hashlib.file_digest

    def counted(file, kind):
        counts[Path(os.fsdecode(file.name)).name] += 1
        return digest(file, kind)

    monkeypatch.setattr(hashes.hashlib, "file_digest", counted)
    return counts


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The folder that keeps the hashes."""
    monkeypatch.setenv("VPRBENCH_HASHES", str(tmp_path / "hashes"))
    return tmp_path / "hashes"


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def files(tmp_path, count):
    return [write(tmp_path / "frames" / f"{i}.png", b"frame %d" % i) for i in range(count)]


def expected(paths):
    return [(len(path.read_bytes()), hashlib.sha256(path.read_bytes()).digest()) for path in paths]


def are_right(paths):
    found = file_hashes(paths)
    return [*zip(found.sizes, found, strict=True)] == expected(paths)


def refused(paths):
    with pytest.raises(BadInput) as caught:
        file_hashes(paths)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_hash_of_a_file_is_its_sha256_whatever_its_name_and_what_cannot_be_read_is_named(tmp_path):
    paths = [write(tmp_path / "a.png", b""), write(tmp_path / os.fsdecode(b"hiver-\xe9t\xe9.png"), b"abc")]
    for _ in range(2):
        found = file_hashes(paths)
        assert (found.sizes.tolist(), [sha256.hex() for sha256 in found]) == ([0, 3], [EMPTY, ABC])
    for wrong in (tmp_path / "absent.png", tmp_path):
        assert f"{wrong} cannot be read (" in refused([*paths, wrong])


def test_a_second_call_reads_unknown_files_alone(tmp_path, folder, read, monkeypatch):
    a, b, c, d, e = files(tmp_path, 5)
    other = write(tmp_path / "others" / "0.png", b"of another folder")
    assert [*file_hashes([])] == []
    assert not folder.exists()
    assert are_right([c, a, c, b, other, a])
    assert read == {"0.png": 2, "1.png": 1, "2.png": 1}
    read.clear()
    monkeypatch.chdir(tmp_path / "frames")  # a file is known by its relative name too
    assert are_right([a, Path("1.png"), c, d, e, other])
    assert read == {"3.png": 1, "4.png": 1}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps no time of change that nobody can set back")
def test_a_file_is_read_again_once_it_has_another_name_time_or_content(tmp_path, read):
    path = write(tmp_path / "a.png", b"winter")
    os.utime(path, ns=(0, 0))
    file_hashes([path])
    os.utime(path, ns=(1, 1))
    file_hashes([path])
    path = path.rename(tmp_path / "b.png")
    assert are_right([path])
    other = write(tmp_path / "c.png", b"summer")
    os.utime(other, ns=(1, 1))
    other.replace(path)
    assert are_right([path])
    assert read.total() == 4
    before = path.stat()
    while path.stat().st_ctime_ns == before.st_ctime_ns:  # until the clock of the file system has gone on
        path.write_bytes(b"autumn")
        os.utime(path, ns=(1, 1))
    after = path.stat()
    assert (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    assert are_right([path])


def test_a_file_that_changes_while_it_is_read_is_refused(tmp_path, monkeypatch):
    path, digest = write(tmp_path / "a.png", b"half"), hashlib.file_digest

    def overtaken(file, kind):
        found = digest(file, kind)
        with path.open("ab") as end:
            end.write(b" more")
        return found

    with monkeypatch.context() as patch:
        patch.setattr(hashes.hashlib, "file_digest", overtaken)
        assert refused([path]).startswith(f"{path} changes while it is read")
    assert are_right([path])


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[: len(content) // 2],
        lambda content: b"\xa5" * len(content),
        lambda content: b"[]",
        lambda content: b'{"files": 5}',
    ],
)
def test_a_damaged_file_of_hashes_is_made_anew(tmp_path, folder, read, caplog, damage):
    paths = files(tmp_path, 20)
    file_hashes(paths)
    (kept,) = folder.iterdir()
    kept.write_bytes(damage(kept.read_bytes()))
    assert are_right(paths)
    assert [str(kept) in record.getMessage() for record in caplog.records] == [True]
    read.clear()
    assert are_right(paths)
    assert not read


def test_where_no_hashes_can_be_kept_they_are_right_and_one_line_says_so(tmp_path, folder, caplog):
    folder.write_bytes(b"")
    paths = files(tmp_path, 3)
    assert are_right(paths)
    assert are_right(paths[:1])
    assert len(caplog.records) == 1


def test_threads_that_hash_the_same_folder_at_once_get_the_right_hashes(tmp_path, read):
    paths = files(tmp_path, 60)
    with ThreadPoolExecutor(6) as threads:
        assert all(threads.map(lambda i: are_right(paths[i:] + paths[:i]), range(12)))
    read.clear()
    assert are_right(paths)
    assert not read


def test_the_folder_is_in_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *names, **_: tmp_path.joinpath(*names))
    monkeypatch.delenv("VPRBENCH_HASHES")
    assert are_right(files(tmp_path, 2))
    assert [path.suffix for path in (tmp_path / "vprbench" / "hashes").iterdir()] == [".json"]


def test_progress_counts_all_files_of_all_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(hashes, "_REPORT_EVERY", 4)
    paths = [*files(tmp_path, 8), *(write(tmp_path / "others" / f"{i}.png", b"%d" % i) for i in range(8))]
    file_hashes(paths[:4])
    shares = []
    with listening(lambda stage, done: shares.append((stage, done))):
        file_hashes(paths)
    assert shares == [("hashing frames", share) for share in (4 / 16, 12 / 16, 1.0)]


FOLDERS = {
    "VPRBENCH_WEIGHTS": weights_folder,
    "VPRBENCH_PARTIAL": lambda: cache_folder("VPRBENCH_PARTIAL", "partial"),
    "VPRBENCH_HASHES": hashes_folder,
}


@pytest.mark.parametrize("variable", FOLDERS)
def test_a_cache_of_a_user_without_name_and_home_asks_for_its_variable(variable, monkeypatch):
    def unknown(_):
        raise KeyError("uid not found")

    monkeypatch.setattr(pwd, "getpwuid", unknown)  # as in many a container
    for name in ("HOME", "XDG_CACHE_HOME", *FOLDERS):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BadInput, match=f"HOME, or {variable}"):
        FOLDERS[variable]()
    monkeypatch.setenv(variable, "~/kept")
    with pytest.raises(BadInput, match=f"{variable}=~/kept"):
        FOLDERS[variable]()
    monkeypatch.setenv(variable, "kept")
    assert FOLDERS[variable]() == Path("kept")
