"""Files are replaced as a whole: a reader of the old file keeps it, and a full disk changes nothing."""

import pytest
from file_limit import no_file_may_exceed

from vprbench.storage.atomic import replace_bytes


def test_a_reader_keeps_the_old_file_and_a_full_disk_leaves_it_alone(tmp_path):
    path = tmp_path / "table.csv"
    replace_bytes(path, b"old")
    with path.open("rb") as reader:
        replace_bytes(path, b"new")
        assert (reader.read(), path.read_bytes()) == (b"old", b"new")
    with no_file_may_exceed(1000), pytest.raises(OSError, match="large"):
        replace_bytes(path, bytes(2000))
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("table.csv", b"new")]
