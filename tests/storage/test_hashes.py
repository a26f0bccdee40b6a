"""Hashes of files are right whatever happens to them, and computed once; a cache without a home asks for it."""

import hashlib
import os
import pwd
import sqlite3
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import platformdirs
import pytest

from vprbench.api.weights import weights_folder
from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.storage import hashes as file_hashes
from vprbench.storage.folders import cache_folder
from vprbench.storage.hashes import FileHash, FileHashes, hashes_folder

SECOND = 1_000_000_000  # nanoseconds
YEAR_2096 = 4_000_000_000 * SECOND
EMPTY = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"  # of the standard, FIPS 180-4
ABC = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@pytest.fixture
def read(monkeypatch):
    """How often each file was read, by name."""
    counts = Counter()
    digest = file_hashes.file_digest

    def counted(file, kind):
        counts[Path(os.fsdecode(file.name)).name] += 1
        return digest(file, kind)

    monkeypatch.setattr(file_hashes, "file_digest", counted)
    return counts


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "hashes"


def later(folder):
    """Return the hashes in a folder as seen when no file has changed for long."""
    return FileHashes(folder, lambda: YEAR_2096)


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def files(tmp_path, count):
    return [write(tmp_path / "frames" / f"{i}.png", b"frame %d" % i) for i in range(count)]


def expected(paths):
    return [FileHash(len(path.read_bytes()), hashlib.sha256(path.read_bytes()).digest()) for path in paths]


def are_right(hashes, paths):
    return [*hashes.of(paths)] == expected(paths)


def refused(hashes, paths):
    with pytest.raises(BadInput) as caught:
        hashes.of(paths)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_hash_of_a_file_is_its_sha256_whatever_its_name_and_what_cannot_be_read_is_named(tmp_path, folder):
    paths = [write(tmp_path / "a.png", b""), write(tmp_path / os.fsdecode(b"hiver-\xe9t\xe9.png"), b"abc")]
    for _ in range(2):
        found = later(folder).of(paths)
        assert [(file.size_bytes, file.sha256.hex()) for file in found] == [(0, EMPTY), (3, ABC)]
    for wrong in (tmp_path / "absent.png", tmp_path):
        assert f"{wrong} cannot be read (" in refused(later(folder), [*paths, wrong])


@pytest.mark.parametrize("again", [False, True], ids=["another program", "the same one"])
def test_a_second_call_reads_what_came_since_alone(tmp_path, folder, read, monkeypatch, again):
    (a, b, c, d, e), first = files(tmp_path, 5), later(folder)
    assert [*first.of([])] == []
    assert not folder.exists()
    assert are_right(first, [c, a, c, b, a])
    assert set(read.values()) == {1}
    read.clear()
    monkeypatch.chdir(tmp_path / "frames")  # a file is known by its relative name too
    assert are_right(first if again else later(folder), [a, Path("1.png"), c, d, e])
    assert read == {"3.png": 1, "4.png": 1}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps no time of change that nobody can set back")
def test_a_file_is_read_again_once_it_has_another_name_time_inode_or_content(tmp_path, folder, read):
    path = write(tmp_path / "a.png", b"winter")
    os.utime(path, ns=(0, 0))
    later(folder).of([path])
    os.utime(path, ns=(1, 1))
    later(folder).of([path])
    path = path.rename(tmp_path / "b.png")
    assert are_right(later(folder), [path])
    other = write(tmp_path / "c.png", b"summer")
    os.utime(other, ns=(1, 1))
    other.replace(path)
    assert are_right(later(folder), [path])
    assert read.total() == 4
    before = path.stat()
    while path.stat().st_ctime_ns == before.st_ctime_ns:  # until the clock of the file system has gone on
        path.write_bytes(b"autumn")
        os.utime(path, ns=(1, 1))
    after = path.stat()
    assert (after.st_size, after.st_mtime_ns, after.st_ino) == (before.st_size, before.st_mtime_ns, before.st_ino)
    assert are_right(later(folder), [path])


@pytest.mark.parametrize(
    ("seconds", "times_read"), [(0.0, 2), (1.9, 2), (2.1, 1), (-1.9, 2)], ids=["now", "just now", "before", "to come"]
)
def test_a_file_that_changed_less_than_two_seconds_ago_is_not_kept(tmp_path, folder, read, seconds, times_read):
    (path,) = files(tmp_path, 1)
    os.utime(path, ns=(0, 0))  # the change of its content is long ago, that of its times is not
    now = path.stat().st_ctime_ns + int(seconds * SECOND)
    hashes = FileHashes(folder, lambda: now)
    assert all(are_right(hashes, [path]) for _ in range(2))
    assert read == {"0.png": times_read}


@pytest.mark.parametrize("times", [2, 3])
def test_a_file_that_is_being_written_is_read_until_it_is_whole_but_not_for_ever(tmp_path, folder, monkeypatch, times):
    path, digest = write(tmp_path / "a.png", b"half"), file_hashes.file_digest
    rest = [b" more"] * times

    def overtaken(file, kind):
        found = digest(file, kind)
        if rest:
            with path.open("ab") as end:
                end.write(rest.pop())
        return found

    monkeypatch.setattr(file_hashes, "file_digest", overtaken)
    if times == 2:
        assert [*later(folder).of([path])] == [FileHash(14, hashlib.sha256(b"half more more").digest())]
    else:
        assert refused(later(folder), [path]).startswith(f"{path} changes while it is read")


@pytest.mark.parametrize("kept", [0, 0.5], ids=["overwritten", "torn"])
def test_a_damaged_database_is_begun_anew(tmp_path, folder, read, caplog, kept):
    paths = files(tmp_path, 200)
    later(folder).of(paths)
    (database,) = folder.iterdir()
    whole = database.read_bytes()
    database.write_bytes(whole[: int(kept * len(whole))] + b"\xa5" * (len(whole) // 2))
    assert are_right(later(folder), paths)
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"{database} is damaged (")
    read.clear()
    assert are_right(later(folder), paths)
    assert not read


@pytest.mark.parametrize("which", ["hashes", "hashes/files-1.sqlite3"])
def test_where_no_database_can_be_made_the_hashes_are_right(tmp_path, folder, caplog, which, read):
    if which == "hashes":
        folder.write_bytes(b"")
    else:
        (tmp_path / which).mkdir(parents=True)
    paths, hashes = files(tmp_path, 3), later(folder)
    assert are_right(hashes, paths)
    assert are_right(hashes, paths[:1])
    assert (len(caplog.records), read.total()) == (1, 3)


def test_several_threads_and_programs_share_the_hashes(tmp_path, folder, read, caplog):
    paths, programs = files(tmp_path, 60), [later(folder) for _ in range(3)]
    with ThreadPoolExecutor(6) as threads:
        assert all(threads.map(lambda i: are_right(programs[i % 3], paths[i:] + paths[:i]), range(12)))
    assert caplog.records == []
    read.clear()
    assert are_right(later(folder), paths)
    assert not read
    with closing(sqlite3.connect(folder / "files-1.sqlite3")) as database, database:
        database.execute("UPDATE files SET sha256 = x'1234'")
    assert are_right(later(folder), paths)  # what is no hash is not taken for one


def test_the_folder_is_in_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *names, **_: tmp_path.joinpath(*names))
    monkeypatch.delenv("VPRBENCH_HASHES")
    monkeypatch.setattr(file_hashes, "time_ns", lambda: YEAR_2096)
    paths = files(tmp_path, 2)
    assert [*file_hashes.file_hashes(paths)] == expected(paths)
    assert [path.name for path in (tmp_path / "vprbench" / "hashes").iterdir()] == ["files-1.sqlite3"]


def test_more_files_than_a_batch_are_told_of_once_and_known_ones_found_again(tmp_path, folder, monkeypatch, read):
    monkeypatch.setattr(file_hashes, "_BATCH", 4)
    paths, told = files(tmp_path, 13), list[tuple[str, float]]()
    with listening(lambda stage, done: told.append((stage, done))):
        for some in (paths[:4], paths, paths):
            later(folder).of(some)
    assert told == [("hashing frames", share) for share in (4 / 9, 8 / 9, 1.0)]
    monkeypatch.setattr(file_hashes, "_ASKED", 3)
    paths = files(tmp_path, 40)
    later(folder).of(paths)
    read.clear()
    for asked in ([0, 20, 39], [*range(40)], [39, 3, 39, 20]):
        assert are_right(later(folder), [paths[number] for number in asked])
    assert not read


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
