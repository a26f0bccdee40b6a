"""What a run records of its frames: worked out by hand, stored and printed."""

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
from little import picture
from little_runs import quiet_surroundings
from PIL import Image as PillowImage

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.cli import main
from vprbench.runs.identity import hash_frames


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def record(references, queries):
    references, queries = (
        images if isinstance(images, Images) else Images.from_files(images) for images in (references, queries)
    )
    right = (np.array([0]),) * len(queries)
    return hash_frames(Dataset("journey", references, np.arange(len(references)), queries, right, {}))[1]


@pytest.fixture
def frames(tmp_path):
    """Files of references and of queries."""
    files = [[tmp_path / f"winter/{name}.png" for name in "bac"], [tmp_path / f"{name}.png" for name in "ad"]]
    for times, paths in zip((3, 5), files, strict=True):
        for path in paths:
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(path.stem.encode() * times)
    return files


NAMES = sha256(b"b.png\na.png\nc.png\na.png\nd.png")


def test_the_record_of_files_is_as_worked_out_by_hand_and_names_content_and_order_change_their_part_of_it(
    frames, tmp_path
):
    winter, summer = frames
    contents = [b"bbb", b"aaa", b"ccc", b"aaaaa", b"ddddd"]
    content = sha256(b"".join(hashlib.sha256(content).digest() for content in contents))
    before = record(winter, summer)
    assert before == {"names_sha256": NAMES, "content_sha256": content, "images": 5, "bytes": 19}
    no_unicode = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xe9t\xe9.png"))
    no_unicode.write_bytes(b"abc")
    assert record([no_unicode], summer)["names_sha256"] == sha256(b"\xe9t\xe9.png\na.png\nd.png")
    moved = winter[0].parent.rename(winter[0].parent.with_name("elsewhere"))
    winter = [moved / path.name for path in winter]
    assert record(winter, summer) == before

    def changed(references, queries):
        return {name for name, value in record(references, queries).items() if value != before[name]}

    assert changed(winter[::-1], summer) == changed(winter, summer[::-1]) == {"names_sha256", "content_sha256"}
    winter[1].write_bytes(b"aba")
    assert changed(winter, summer) == {"content_sha256"}
    winter[1].write_bytes(b"aaa")
    assert changed([winter[0], winter[1].rename(moved / "e.png"), winter[2]], summer) == {"names_sha256"}


def test_a_run_of_files_prints_and_stores_their_record(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    paths = [tmp_path / folder / f"{i}.png" for folder in ("winter", "summer") for i in range(3)]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        number = int(path.stem) + 3 * (path.parent.name == "summer")
        PillowImage.fromarray(picture(number)).resize((16, 16)).save(path)
    options = ["dataset=folders", "dataset.references=[winter]", "dataset.queries=summer", "timing=none", "threads=1"]
    with quiet_surroundings():
        assert main(["method=sad", *options, "output=json"]) == 0
    row = json.loads(capsys.readouterr().out)
    (stored,) = (tmp_path / "results").rglob("run.json")
    assert row["data"] == json.loads(stored.read_text("utf-8"))["data"]
    assert (row["data"]["images"], row["data"]["bytes"]) == (6, sum(path.stat().st_size for path in paths))
    assert row["data"]["names_sha256"] == sha256(b"0.png\n1.png\n2.png\n0.png\n1.png\n2.png")
