"""Long arrays in shards: the rows of a plain array, whichever file has them, and written on after a kill."""

import pickle

import numpy as np
import pytest

from vprbench.storage import shards
from vprbench.storage.shards import Shards, Writer

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


@pytest.mark.parametrize(
    ("n_rows", "least", "most"), [(1, 1, 1), (10_000, 5, 15), (2_800_000, 200, 256), (10**9, 200, 256)]
)
def test_there_are_never_many_files(n_rows, least, most, monkeypatch):
    monkeypatch.setattr(shards, "_LEAST_ROWS", 1024)
    parts = shards.borders(n_rows)
    assert least <= len(parts) <= most
    assert (parts[0].start, parts[-1].stop) == (0, n_rows)
    assert all(part.start % 64 == 0 for part in parts)
