"""Files are replaced as a whole, very many paths stand in order, and hashes are right and computed once."""

import hashlib
import os
import pwd
import shutil
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from file_limit import no_file_may_exceed
from hypothesis import example, given, settings
from hypothesis import strategies as st

from vprbench.errors import BadInput
from vprbench.storage import hashes
from vprbench.storage.atomic import replace_bytes
from vprbench.storage.hashes import find_hashes_folder, hash_each_file
from vprbench.storage.paths import Paths
from vprbench.storage.row_files import keep_rows


def test_a_reader_keeps_the_old_file_and_a_full_disk_leaves_it_alone(tmp_path):
    path = tmp_path / "table.csv"
    replace_bytes(path, b"old")
    with path.open("rb") as reader:
        replace_bytes(path, b"new")
        assert (reader.read(), path.read_bytes()) == (b"old", b"new")
    with no_file_may_exceed(1000), pytest.raises(OSError, match="large"):
        replace_bytes(path, bytes(2000))
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("table.csv", b"new")]


ROWS = np.random.default_rng(0).standard_normal((3000, 5)).astype(np.float32)


def test_of_two_that_want_the_same_rows_one_makes_them_and_a_third_finds_them_all(tmp_path):
    began = []

    def make(first):
        began.append(first)
        time.sleep(0.05)
        yield from np.array_split(ROWS[first:], 7)

    with ThreadPoolExecutor(2) as threads:
        made = [*threads.map(lambda _: keep_rows(tmp_path / "rows.npy", len(ROWS), make), range(2))]
    made.append(keep_rows(tmp_path / "rows.npy", len(ROWS), make))
    assert (began, sorted(kept for _, kept in made)) == ([0], [0, 3000, 3000])
    assert all(np.array_equal(rows, ROWS) for rows, _ in made)


@pytest.mark.parametrize("n_rows", [2999, 3001])
def test_more_or_fewer_rows_than_stated_are_an_error(tmp_path, n_rows):
    with pytest.raises(ValueError, match="3000 rows came"):
        keep_rows(tmp_path / "rows.npy", n_rows, lambda first: [ROWS])


FILES = st.text(alphabet="ab.019 /é", max_size=8).map("{}1.png".format)
quiet = settings(derandomize=True, deadline=None, database=None, max_examples=100)


@quiet
@given(st.lists(FILES, max_size=12), st.sampled_from(["/top", ".", "top/of"]))
@example(["b.jpg", "c/d.jpg", "c//d.jpg", "c/../e.jpg", "/r/z.jpg", "/z.jpg", "./f"], "/top")
def test_paths_below_a_folder_are_those_that_pathlib_makes(texts, top):
    wanted = [Path(top) / text for text in texts]
    paths = Paths.below(Path(top), texts)
    assert [*paths] == [*Paths.of(wanted)] == wanted
    assert paths.names == tuple(path.name for path in wanted)
    assert [*paths[::-2]] == wanted[::-2]
    assert [*paths[np.arange(len(wanted)) % 3 == 0]] == wanted[::3]
    assert [*Paths.joined([paths, paths[1:]])] == [*wanted, *wanted[1:]]


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


def numbered_files(tmp_path, count):
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
    a, b, c, d, e = numbered_files(tmp_path, 5)
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
    paths = numbered_files(tmp_path, 20)
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
