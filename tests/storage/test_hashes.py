"""Hashes of files are right whatever happens to them, and computed once; a cache without a home asks for it."""

import hashlib
import os
import pwd
import shutil
import sys
from collections import Counter
from pathlib import Path

import pytest

from vprbench.errors import BadInput
from vprbench.storage import hashes
from vprbench.storage.hashes import find_hashes_folder, hash_each_file

EMPTY = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"  # of the standard, FIPS 180-4
ABC = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@pytest.fixture
def read(monkeypatch):
    """How often each file was read, by name."""
    counts = Counter()
    digest = hashlib.file_digest

    def count(file, kind):
        counts[Path(os.fsdecode(file.name)).name] += 1
        return digest(file, kind)

    monkeypatch.setattr(hashes.hashlib, "file_digest", count)
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


def are_right(paths):
    contents = [path.read_bytes() for path in paths]
    return hash_each_file(paths) == [(len(content), hashlib.sha256(content).digest()) for content in contents]


def test_the_hash_of_a_file_is_its_sha256_whatever_its_name_and_the_unreadable_file_is_named(tmp_path):
    paths = [write(tmp_path / "a.png", b""), write(tmp_path / os.fsdecode(b"hiver-\xe9t\xe9.png"), b"abc")]
    for _ in range(2):
        assert [(size, sha256.hex()) for size, sha256 in hash_each_file(paths)] == [(0, EMPTY), (3, ABC)]
    for wrong in (tmp_path / "absent.png", tmp_path):
        with pytest.raises(BadInput, match=rf"{wrong} cannot be read \(.*restore the file$"):
            hash_each_file([*paths, wrong])


def test_a_second_call_reads_unknown_files_alone(tmp_path, folder, read, monkeypatch):
    a, b, c, d, e = files(tmp_path, 5)
    other = write(tmp_path / "others" / "0.png", b"of another folder")
    assert are_right([])
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
    hash_each_file([path])
    os.utime(path, ns=(1, 1))
    hash_each_file([path])
    path = path.rename(tmp_path / "b.png")
    assert are_right([path])
    other = write(tmp_path / "c.png", b"summer")  # of the same size
    os.utime(other, ns=(1, 1))  # and time of modification
    other.replace(path)
    assert are_right([path])
    assert read.total() == 4


@pytest.mark.parametrize("damage", [lambda whole: whole[:40], lambda _: b"\xa5", lambda _: b"[]", lambda _: b"{}"])
def test_a_damaged_file_of_hashes_is_made_anew_and_no_folder_needed(tmp_path, folder, read, damage):
    paths = files(tmp_path, 20)
    hash_each_file(paths)
    (kept,) = folder.iterdir()
    kept.write_bytes(damage(kept.read_bytes()))
    assert are_right(paths)
    read.clear()
    assert are_right(paths)
    assert not read
    shutil.rmtree(folder)
    folder.write_bytes(b"")  # takes no hashes
    assert are_right(paths)


def test_a_user_without_name_and_home_has_to_name_the_folder(monkeypatch):
    def unknown(_):
        raise KeyError("uid not found")

    monkeypatch.setattr(pwd, "getpwuid", unknown)  # as in many a container
    for name in ("HOME", "XDG_CACHE_HOME", "VPRBENCH_HASHES"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BadInput, match="HOME, or VPRBENCH_HASHES"):
        find_hashes_folder()
    monkeypatch.setenv("VPRBENCH_HASHES", "~/kept")
    with pytest.raises(BadInput, match="VPRBENCH_HASHES=~/kept"):
        find_hashes_folder()
    monkeypatch.setenv("VPRBENCH_HASHES", "kept")
    assert find_hashes_folder() == Path("kept")
