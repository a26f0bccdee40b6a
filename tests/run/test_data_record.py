"""What a run records of its frames: worked out by hand, stored, printed, and seen by what else looks at files."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little import Lookup, a_failure, a_run, journey, picture
from little_runs import QUICK, quiet_surroundings, run_of
from PIL import Image as PillowImage

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.cli import main
from vprbench.run import rows
from vprbench.run.identity import DataRecord, data_record
from vprbench.run.store import Store
from vprbench.storage import hashes

RECORD: dict[str, Any] = {
    "names_sha256": "5f74d2dc7bb3" + "0" * 52,
    "content_sha256": None,
    "images": 14,
    "bytes": None,
}


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def write(path: Path, content: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def dataset_of(references: Images, queries: Images) -> Dataset:
    n = len(references)
    return Dataset("journey", references, np.arange(n), queries, (np.array([0]),) * len(queries), {})


@pytest.fixture
def winter(tmp_path: Path) -> list[Path]:
    return [write(tmp_path / "winter" / f"{name}.png", name.encode() * 3) for name in ("b", "a", "c")]


@pytest.fixture
def summer(tmp_path: Path) -> list[Path]:
    return [write(tmp_path / "summer" / f"{name}.png", name.encode() * 5) for name in ("a", "d")]


def record(references: list[Path], queries: list[Path]) -> DataRecord:
    return data_record(dataset_of(Images.from_files(references), Images.from_files(queries)))


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Counter[str]]:
    """How often each file was read, by folder and name, where none has changed for long."""
    counts: Counter[str] = Counter()
    digest = hashes.file_digest

    def counted(file: Any, kind: str) -> Any:
        counts["/".join(Path(os.fsdecode(file.name)).parts[-2:])] += 1
        return digest(file, kind)

    monkeypatch.setenv("VPRBENCH_HASHES", str(tmp_path / "hashes"))
    monkeypatch.setattr(hashes, "time_ns", lambda: 4 * 10**18)
    monkeypatch.setattr(hashes, "file_digest", counted)
    return counts


# The record


def test_the_record_of_files_is_as_worked_out_by_hand(winter: list[Path], summer: list[Path]) -> None:
    contents = [b"bbb", b"aaa", b"ccc", b"aaaaa", b"ddddd"]
    assert record(winter, summer) == {
        "names_sha256": sha256(b"b.png\na.png\nc.png\na.png\nd.png"),
        "content_sha256": sha256(b"".join(hashlib.sha256(content).digest() for content in contents)),
        "images": 5,
        "bytes": 19,
    }


def test_names_content_and_order_change_their_part_of_the_record_and_the_folder_none(
    winter: list[Path], summer: list[Path]
) -> None:
    before = record(winter, summer)
    moved = winter[0].parent.rename(winter[0].parent.with_name("elsewhere"))
    winter = [moved / path.name for path in winter]
    assert record(winter, summer) == before

    def changed(references: list[Path], queries: list[Path]) -> set[str]:
        return {name for name, value in record(references, queries).items() if value != before[name]}

    assert changed(winter[::-1], summer) == changed(winter, summer[::-1]) == {"names_sha256", "content_sha256"}
    winter[1].write_bytes(b"aba")
    assert changed(winter, summer) == {"content_sha256"}
    winter[1].write_bytes(b"aaa")
    assert changed([winter[0], winter[1].rename(moved / "e.png"), winter[2]], summer) == {"names_sha256"}


@pytest.mark.parametrize("rendered", ["references", "queries", "both"])
def test_frames_that_are_no_files_have_names_alone(winter: list[Path], summer: list[Path], rendered: str) -> None:
    references, queries = Images.from_files(winter), Images.from_files(summer)
    if rendered != "queries":
        references = Images.from_arrays([picture(i) for i in range(3)], references.names)
    if rendered != "references":
        queries = Images.from_arrays([picture(i) for i in range(2)], queries.names)
    assert data_record(dataset_of(references, queries)) == {
        "names_sha256": sha256(b"b.png\na.png\nc.png\na.png\nd.png"),
        "content_sha256": None,
        "images": 5,
        "bytes": None,
    }


def test_names_that_are_no_unicode_are_hashed_as_the_bytes_they_are(summer: list[Path], tmp_path: Path) -> None:
    path = write(Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xe9t\xe9.png")), b"abc")
    assert record([path], summer)["names_sha256"] == sha256(b"\xe9t\xe9.png\na.png\nd.png")


# Hashes of images


def test_fingerprint_record_and_content_of_views_read_a_file_once(
    winter: list[Path], summer: list[Path], read: Counter[str]
) -> None:
    dataset = dataset_of(Images.from_files(winter), Images.from_files([*summer, winter[2]]))
    for images in (dataset.references, dataset.queries, dataset.references[1:], dataset.queries[::-1]):
        images.fingerprint()
        images.content_hash()
    data_record(dataset)
    assert read == {f"winter/{name}.png": 1 for name in "abc"} | {f"summer/{name}.png": 1 for name in "ad"}


def test_a_byte_in_the_middle_of_a_large_file_changes_its_fingerprint(tmp_path: Path) -> None:
    content = bytearray(100_000)
    path = write(tmp_path / "a.jpg", content)
    before = Images.from_files([path]).fingerprint()
    content[50_000] = 1
    path.write_bytes(content)
    assert Images.from_files([path]).fingerprint() != before


def test_the_content_of_files_is_the_hash_of_their_hashes(winter: list[Path]) -> None:
    wanted = sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in winter))
    assert Images.from_files(winter).content_hash() == wanted


@pytest.mark.parametrize("hashed", ["fingerprint", "content_hash"])
def test_what_images_are_made_from_beside_their_files_changes_their_hash(winter: list[Path], hashed: str) -> None:
    def made(besides: bytes, files: list[Path]) -> str:
        images = Images(lambda i: picture(i), "abc", files=files, stamp=lambda i: besides, content=lambda i: besides)
        return str(getattr(images[:], hashed)())

    assert made(b"lens 1", winter) == made(b"lens 1", winter)
    assert len({made(b"lens 1", winter), made(b"lens 2", winter), made(b"lens 1", winter[::-1])}) == 3


@pytest.mark.parametrize("hashed", ["fingerprint", "content_hash"])
def test_images_with_a_stamp_and_content_are_not_decoded_to_be_hashed(hashed: str) -> None:
    def made(besides: bytes) -> str:
        images = Images(
            lambda _: pytest.fail("an image was read"), "abc", stamp=lambda _: besides, content=lambda _: besides
        )
        return str(getattr(images, hashed)())

    assert made(b"lens 1") == made(b"lens 1") != made(b"lens 2")


# The run


def test_a_run_records_the_data_it_used_and_has_it_back_from_the_store(tmp_path: Path) -> None:
    with quiet_surroundings():
        made = run_of(Lookup(np.ones((6, 4), np.float32)), journey(6, 4), QUICK)
    assert made.data == data_record(journey(6, 4))
    assert made.data["images"] == 10
    store = Store(tmp_path / "results")
    store.prepare()
    store.save(made)
    assert [run.data for run in store.runs()] == [made.data]


def test_the_protocol_line_ends_with_the_first_digits_of_the_names() -> None:
    assert rows.protocol_line(a_run(data=RECORD)).endswith("tolerance_places 0), data 5f74d2dc7bb3")


def test_csv_tells_protocol_and_data_of_each_run_that_knows_them() -> None:
    protocol = {"protocol": "vprtempo", **a_run().protocol}
    text = rows.csv([a_failure(), a_run(), a_run(data=RECORD, protocol=protocol)])
    names = ("protocol", "names_sha256", "content_sha256")
    assert [[line[name] for name in names] for line in csv.DictReader(io.StringIO(text))] == [
        ["", "", ""],
        ["", "", ""],
        ["vprtempo", RECORD["names_sha256"], ""],
    ]


def test_a_run_of_files_prints_and_stores_their_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    paths = []
    for folder in ("winter", "summer"):
        for i in range(3):
            paths.append(tmp_path / folder / f"{i}.png")
            paths[-1].parent.mkdir(exist_ok=True)
            PillowImage.fromarray(picture(i)).resize((16, 16)).save(paths[-1])
    timing = ["timing.minimum_seconds=0", "timing.sample=3", "timing.minimum_queries=3", "timing.batch_sizes=[1]"]
    frames = ["dataset=folders", "dataset.references=[winter]", "dataset.queries=summer"]
    with quiet_surroundings():
        assert main(["method=sad", *frames, *timing, "threads=1", "output=json"]) == 0
    row = json.loads(capsys.readouterr().out)
    (stored,) = (tmp_path / "results").rglob("run.json")
    assert row["data"] == json.loads(stored.read_text("utf-8"))["data"]
    assert row["data"] == {
        "names_sha256": sha256(b"0.png\n1.png\n2.png\n0.png\n1.png\n2.png"),
        "content_sha256": sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in paths)),
        "images": 6,
        "bytes": sum(len(path.read_bytes()) for path in paths),
    }
