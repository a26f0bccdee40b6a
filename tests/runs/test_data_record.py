"""What a run records of its frames, and that it says how many of its queries are in the map before it encodes any."""

import hashlib
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

import vprbench
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.runs.identity import hash_frames

pytestmark = pytest.mark.usefixtures("surroundings")


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def record(references, queries):
    references, queries = (
        images if isinstance(images, Images) else Images.from_files(images) for images in (references, queries)
    )
    right = (np.array([0]),) * len(queries)
    return hash_frames(Dataset("journey", references, np.arange(len(references)), queries, right, {}))[1]


NAMES = sha256(b"b.png\na.png\nc.png\na.png\nd.png")


def test_the_record_of_files_is_as_worked_out_by_hand_and_names_content_and_order_change_their_part_of_it(tmp_path):
    winter, summer = [tmp_path / f"winter/{name}.png" for name in "bac"], [tmp_path / f"{name}.png" for name in "ad"]
    winter[0].parent.mkdir()
    for path in (*winter, *summer):
        path.write_bytes(path.stem.encode() * (3 if path in winter else 5))
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


PLACES = 12
QUICK = ["method=sad", "timing=none", "threads=1", "frames=false", "output=json"]
DAY = np.random.default_rng(0).integers(0, 256, (PLACES, 24, 32), np.uint8)
NIGHT = DAY[:, ::-1]
TWICE = ["dataset=folders", "dataset.references=[day]", "dataset.queries=day"]
COPIES = ["dataset=folders", "dataset.references=[night,day]", "dataset.queries=copies"]  # under other names


@pytest.fixture(autouse=True)
def drive(tmp_path, monkeypatch):
    """Run in a folder with the frames of a day and of a night."""
    monkeypatch.chdir(tmp_path)
    for folder, name, frames in (("day", "", DAY), ("night", "", NIGHT), ("copies", "other", DAY)):
        Path(folder).mkdir()
        for k, frame in enumerate(frames):
            cv2.imwrite(f"{folder}/{name}{k:02}.png", frame)


def test_a_run_of_files_prints_and_stores_their_record(capsys):
    assert main([*QUICK, "dataset=folders", "dataset.references=[day]", "dataset.queries=night"]) == 0
    row = json.loads(capsys.readouterr().out)
    (stored,) = Path("results").rglob("run.json")
    assert row["data"] == json.loads(stored.read_text("utf-8"))["data"]
    paths = [*Path("day").iterdir(), *Path("night").iterdir()]
    assert (row["data"]["images"], row["data"]["bytes"]) == (24, sum(path.stat().st_size for path in paths))
    assert row["data"]["names_sha256"] == sha256("\n".join(f"{k:02}.png" for k in [*range(PLACES)] * 2).encode())


@pytest.mark.parametrize("options", [TWICE, COPIES])
def test_queries_of_files_in_the_map_are_refused_by_their_number_and_asked_with_a_note_where_allowed(options, capsys):
    assert main([*QUICK, *options]) == 2
    told = capsys.readouterr().err
    assert (f"{PLACES} of {PLACES}" in told, "dataset.shared_frames=allow" in told) == (True, True)
    assert [*Path("results").rglob("run.json")] == []
    assert main([*QUICK, *options, "dataset.shared_frames=allow"]) == 0
    run = json.loads(capsys.readouterr().out)
    assert run["protocol"]["shared_frames"] == "allow"
    assert [f"{PLACES} of {PLACES}" in note["text"] for note in run["notes"] if note["kind"] == "dataset"] == [True]


@pytest.mark.parametrize(
    ("references", "queries", "shared"),
    [
        (DAY, DAY, 12),
        (DAY, np.concatenate([NIGHT[:10], DAY[10:]]), 2),
        (DAY, np.repeat(DAY[..., None], 3, axis=3), 12),  # grey, and the same as colours
        ("day", DAY, 12),  # files against arrays of them
        ("day", NIGHT, 0),
        (np.concatenate([DAY[:10], np.zeros_like(DAY[:2])]), np.concatenate([NIGHT[:9], np.zeros_like(DAY[:3])]), 0),
        (np.full_like(DAY, 255), np.full_like(DAY, 255), 0),  # say nothing of a place: snow on the lens
    ],
)
def test_shared_images_of_a_program_are_counted_by_their_pixels_and_dark_ones_pass(references, queries, shared):
    def run(**options):
        made = vprbench.dataset_of(references, queries, **options)
        return vprbench.run("sad", made, timing="none", results=None, threads=1).run

    if not shared:
        assert "shared_frames" not in run().protocol
        return
    with pytest.raises(BadInput, match=f"{shared} of 12 .* shared_frames='allow'"):
        run()
    assert any(f"{shared} of 12 " in note.text for note in run(shared_frames="allow").notes)


def test_the_doctor_calls_it_an_error_and_where_it_is_allowed_a_warning(capsys):
    for allowed, level in (("error", "error"), ("allow", "warning")):
        assert main(["doctor", *TWICE, f"dataset.shared_frames={allowed}", "output=json"]) == 1
        found = [one["level"] for one in json.loads(capsys.readouterr().out) if one["check"] == "shared frames"]
        assert found == [level]
