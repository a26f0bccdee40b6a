"""Files of arrays and paths: replaced as a whole, shards of one array, and very many paths in order."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from file_limit import no_file_may_exceed
from hypothesis import example, given, settings
from hypothesis import strategies as st
from natsort import natsorted

from vprbench.storage import shards
from vprbench.storage.atomic import replace_bytes
from vprbench.storage.paths import Paths, natural_keys
from vprbench.storage.shards import Shards, Writer


def test_a_reader_keeps_the_old_file_and_a_full_disk_leaves_it_alone(tmp_path):
    path = tmp_path / "table.csv"
    replace_bytes(path, b"old")
    with path.open("rb") as reader:
        replace_bytes(path, b"new")
        assert (reader.read(), path.read_bytes()) == (b"old", b"new")
    with no_file_may_exceed(1000), pytest.raises(OSError, match="large"):
        replace_bytes(path, bytes(2000))
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("table.csv", b"new")]


N, D = 300, 5
ROWS = np.random.default_rng(0).standard_normal((N, D)).astype(np.float32)


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    monkeypatch.setattr(shards, "_LEAST_ROWS", 64)


def written(folder):
    """Return the shards, and the first rows of those that were missing."""
    writer, began = Writer(folder, N), []
    for part in writer.missing():
        began.append(part.start)
        writer.write(part, np.array_split(ROWS[part], 3))
    return writer.shards({"what": "test"}), began


@pytest.mark.parametrize("kind", ["files", "memory"])
def test_shards_hold_the_rows_of_an_array_and_a_piece_goes_to_another_process_by_its_name(tmp_path, kind):
    kept = written(tmp_path)[0] if kind == "files" else Shards.of(ROWS)
    assert (kept.shape, len(kept), kept.nbytes) == ((N, D), N, ROWS.nbytes)
    assert [(piece.first, piece.rows().tolist()) for piece in kept.pieces] == [
        (first, ROWS[first : first + 64].tolist()) for first in (0, 64, 128, 192, 256)
    ]
    for first, last in ((0, N), (None, None), (64, 128), (60, 200), (299, 300), (7, 7), (290, 999)):
        assert np.array_equal(kept[first:last], ROWS[first:last])
    chosen = np.array([[299, 0], [64, 63], [0, 255]])
    assert np.array_equal(kept.take(chosen), ROWS[chosen])
    if kind == "files":  # and what one file has is no copy
        assert isinstance(kept[130:190], np.memmap)
        sent = pickle.dumps(kept.pieces[2])
        assert len(sent) < 500 + len(str(tmp_path)) < 64 * D * 4
        assert np.array_equal(pickle.loads(sent).rows(), ROWS[128:192])


def test_finished_shards_stay_and_missing_or_damaged_ones_are_written_anew(tmp_path, caplog):
    assert written(tmp_path)[1] == [0, 64, 128, 192, 256]
    assert Shards.find(tmp_path, N) is not None
    files = sorted(tmp_path.glob("*.npy"))
    files[1].unlink()
    files[3].write_bytes(files[3].read_bytes()[:-20])
    assert Shards.find(tmp_path, N) is None
    again, began = written(tmp_path)
    assert began == [64, 192]
    assert np.array_equal(again[:], ROWS)
    assert files[3].name in caplog.text
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(("n_rows", "least", "most"), [(1, 1, 1), (10_000, 5, 15), (10**9, 200, 256)])
def test_there_are_never_many_files(n_rows, least, most, monkeypatch):
    monkeypatch.setattr(shards, "_LEAST_ROWS", 1024)
    parts = shards.borders(n_rows)
    assert least <= len(parts) <= most
    assert (parts[0].start, parts[-1].stop) == (0, n_rows)
    assert all(part.start % 64 == 0 for part in parts)


PARTS = st.text(alphabet="ab.019 /é", min_size=1, max_size=8)
quiet = settings(derandomize=True, deadline=None, database=None, max_examples=100)


@quiet
@given(st.lists(PARTS, max_size=12), st.sampled_from(["/top", ".", "top/of"]))
@example(["b.jpg", "c/d.jpg", "c//d.jpg", "c/../e.jpg", "/r/z.jpg", "/z.jpg", "c/", "c/.", "./f", "..", "c/.."], "/top")
def test_paths_below_a_folder_are_those_that_pathlib_makes(texts, top):
    wanted = [Path(top) / text for text in texts]
    paths = Paths.below(Path(top), texts)
    assert [*paths] == [*Paths.of(wanted)] == wanted
    assert paths.names == tuple(path.name for path in wanted)
    assert [*paths[::-2]] == wanted[::-2]
    assert [*paths[np.arange(len(wanted)) % 3 == 0]] == wanted[::3]
    assert [*Paths.joined([paths, paths[1:]])] == [*wanted, *wanted[1:]]
    assert [*paths.absolute()] == [path.absolute() for path in wanted]
    files = np.flatnonzero([path.name != "" for path in wanted])
    assert paths.encoded(files) == [str(wanted[number]).encode() for number in files]


@quiet
@given(st.lists(st.sampled_from(["a/1", "a/2", "b/1", "1", "b/c/2"]), max_size=9))
def test_each_of_the_different_paths_comes_once_and_folders_come_as_they_first_appear(texts):
    paths = Paths.below(Path("/top"), texts)
    order, which = paths.distinct()
    distinct = [paths[number] for number in order]
    assert distinct == sorted({*paths}, key=lambda path: (path.parent, path.name))
    assert [distinct[number] for number in which] == [*paths]
    parents = [path.parent for path in paths]
    found = [(folder, which.tolist()) for folder, which in paths.in_folders()]
    assert found == [(one, [i for i, parent in enumerate(parents) if parent == one]) for one in dict.fromkeys(parents)]


@quiet
@given(st.lists(st.text(alphabet="ab-/.@0019", max_size=9), max_size=20))
@example(["a10", "a9", "a-1", "a", "", "00", "0", "a09b", "a9", "a009c"])
@example(["1" * 250 + "a", "2" * 250, "9"])
@example(["été 2", "a10", "été 10", "a9", "z"])
@example(["e\u0301te\u0301 10", "a10", "été 10", "a9", "a²", "a\n3", "a\xff4"])
@example([f"frame {number * 7919 % 25_000}.png" for number in range(25_000)])
def test_keys_sort_as_natsort_does(texts):
    texts = sorted(texts)
    keys = natural_keys(texts)
    assert [texts[number] for number in sorted(range(len(texts)), key=keys.__getitem__)] == natsorted(texts)
