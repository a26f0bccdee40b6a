"""Files of arrays and paths: replaced as a whole, and very many paths in order."""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from file_limit import no_file_may_exceed
from hypothesis import example, given, settings
from hypothesis import strategies as st

from vprbench.storage.atomic import replace_bytes
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
