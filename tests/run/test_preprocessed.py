"""A traverse that was preprocessed once is read back as it was made, and what it took then still counts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pytest
from little import journey
from little_runs import CONFIG, QUICK, quiet_surroundings
from PIL import Image as PillowImage
from stopped_clock import Clock, ReadersThatWait

from vprbench.api import images, preprocess
from vprbench.api.arrays import Places, Scores
from vprbench.api.dataset import Dataset, HeldOut
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.preprocess import PatchNormalisation
from vprbench.cli import main
from vprbench.run import preprocessed, runner
from vprbench.run.preprocessed import Preprocessed
from vprbench.run.record import Run

N_IMAGES = 260
SMALL = {"height": 6, "width": 8, "patch": 3}
NORMALISE = PatchNormalisation("C", **SMALL)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("traverse")
    pixels = np.random.default_rng(0).integers(0, 256, (N_IMAGES, 9, 12, 3), dtype=np.uint8)
    paths = [folder / f"{number:03}.png" for number in range(N_IMAGES)]
    for path, frame in zip(paths, pixels, strict=True):
        PillowImage.fromarray(frame).save(path)
    return paths


@pytest.fixture
def own_frames(frames: list[Path], tmp_path: Path) -> list[Path]:
    """A copy of the traverse, to be changed."""
    folder = tmp_path / "frames"
    folder.mkdir()
    copies = [folder / path.name for path in frames]
    for path, copy in zip(frames, copies, strict=True):
        copy.write_bytes(path.read_bytes())
    return copies


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The files that are decoded, from here on."""
    found: list[Path] = []
    own = images.read_image

    def noted(path: Path) -> npt.NDArray[np.uint8]:
        found.append(path)
        return own(path)

    monkeypatch.setattr(images, "read_image", noted)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "results" / "preprocessed"


def made(folder: Path, paths: list[Path], normalise: PatchNormalisation = NORMALISE) -> npt.NDArray[np.uint8]:
    """The levels of a traverse as a new process would get them."""
    return normalise(Preprocessed(folder, 1).kept(Images.from_files(paths)))


def test_what_is_kept_is_what_is_made_without_a_cache(frames: list[Path], folder: Path) -> None:
    expected = NORMALISE(Images.from_files(frames))
    np.testing.assert_array_equal(made(folder, frames), expected)
    np.testing.assert_array_equal(made(folder, frames), expected)
    assert len({levels.tobytes() for levels in expected}) == N_IMAGES


def test_the_second_time_no_frame_is_read_and_the_levels_are_memory_mapped(
    frames: list[Path], folder: Path, read: list[Path]
) -> None:
    made(folder, frames)
    assert sorted(read) == frames
    read.clear()
    levels = made(folder, frames)
    assert isinstance(levels, np.memmap)
    assert levels.dtype == np.uint8
    assert read == []


@pytest.mark.parametrize("time", [1, 2])
def test_a_method_that_writes_to_its_levels_changes_nothing_on_disk(
    frames: list[Path], folder: Path, time: int
) -> None:
    for _ in range(time - 1):
        made(folder, frames)
    made(folder, frames)[:] = 7
    np.testing.assert_array_equal(made(folder, frames), NORMALISE(Images.from_files(frames)))


def test_watched_and_unnamed_traverses_are_the_same_traverse(
    frames: list[Path], folder: Path, read: list[Path]
) -> None:
    made(folder, frames)
    read.clear()
    NORMALISE(Preprocessed(folder, 1).kept(Images.from_files(frames)).watched(lambda done: None).unnamed())
    assert read == []


def test_a_part_of_a_traverse_is_preprocessed_as_ever(frames: list[Path], folder: Path, read: list[Path]) -> None:
    made(folder, frames)
    read.clear()
    part = Preprocessed(folder, 1).kept(Images.from_files(frames))[3:7]
    np.testing.assert_array_equal(NORMALISE(part), NORMALISE(Images.from_files(frames[3:7])))
    assert read == frames[3:7] * 2
    assert len(list(folder.glob("*.npy"))) == 1


def test_frames_of_other_content_are_read_anew(own_frames: list[Path], folder: Path, read: list[Path]) -> None:
    before = made(folder, own_frames)
    PillowImage.fromarray(np.eye(9, 12, dtype=np.uint8) * 255).save(own_frames[100])
    read.clear()
    after = made(folder, own_frames)
    assert len(read) == N_IMAGES
    assert np.flatnonzero((before != after).any(axis=1)).tolist() == [100]


def test_the_same_frames_elsewhere_under_other_names_are_not(
    own_frames: list[Path], folder: Path, read: list[Path], tmp_path: Path
) -> None:
    made(folder, own_frames)
    moved = [path.rename(tmp_path / f"{number}.png") for number, path in enumerate(own_frames)]
    read.clear()
    made(folder, moved)
    assert read == []


def test_frames_in_another_order_are_read_anew(frames: list[Path], folder: Path) -> None:
    before = made(folder, frames)
    np.testing.assert_array_equal(made(folder, frames[::-1]), before[::-1])


@pytest.mark.parametrize(
    "changed", [{"variant": "A"}, {"height": 8, "width": 6}, {"width": 9}, {"patch": 5}, {"engine": "readable"}]
)
def test_every_argument_has_levels_of_its_own(frames: list[Path], folder: Path, changed: dict[str, Any]) -> None:
    other = replace(NORMALISE, **changed)
    made(folder, frames)
    np.testing.assert_array_equal(made(folder, frames, other), other(Images.from_files(frames)))
    assert len(list(folder.glob("*.npy"))) == 2


@pytest.mark.parametrize("changed", ["source_hash", "processor", "libraries", "threads"])
def test_other_code_and_what_else_the_time_depends_on_have_levels_of_their_own(
    frames: list[Path], folder: Path, changed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(folder, frames)
    if changed == "source_hash":
        monkeypatch.setattr(preprocessed, "source_hash", lambda _: "changed")
    elif changed == "processor":
        monkeypatch.setattr(preprocessed.machine, "device_class", lambda _: "cpu Abacus 9")
    elif changed == "libraries":
        monkeypatch.setattr(preprocessed.machine, "library_versions", lambda: {"pillow": "0.1"})
    NORMALISE(Preprocessed(folder, 2 if changed == "threads" else 1).kept(Images.from_files(frames)))
    assert len(list(folder.glob("*.npy"))) == 2


def whole(path: Path) -> npt.NDArray[np.uint8]:
    return np.load(path)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-20]),
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("<html>"),
    "other number": lambda path: np.save(path, whole(path)[1:]),
    "other size": lambda path: np.save(path, whole(path)[:, 1:]),
    "other type": lambda path: np.save(path, whole(path).astype(np.int8)),
    "no seconds": lambda path: path.with_suffix(".json").unlink(),
    "damaged seconds": lambda path: path.with_suffix(".json").write_text('{"seconds": "long"}'),
    "text for seconds": lambda path: path.with_suffix(".json").write_text("<html>"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_made_anew_and_replaced(
    frames: list[Path], folder: Path, damage: str, read: list[Path]
) -> None:
    expected = made(folder, frames).copy()
    (path,) = folder.glob("*.npy")
    DAMAGES[damage](path)
    read.clear()
    np.testing.assert_array_equal(made(folder, frames), expected)
    assert len(read) == N_IMAGES
    read.clear()
    np.testing.assert_array_equal(made(folder, frames), expected)
    assert read == []


def test_a_full_disk_costs_the_cache_and_not_the_levels(
    frames: list[Path], folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    np.testing.assert_array_equal(made(folder, frames), NORMALISE(Images.from_files(frames)))
    assert "no preprocessed frames are kept" in caplog.text
    assert "No space left on device" in caplog.text
    assert not list(folder.iterdir())


def test_a_frame_that_cannot_be_read_is_named_and_leaves_nothing(own_frames: list[Path], folder: Path) -> None:
    own_frames[200].write_bytes(own_frames[200].read_bytes()[:90])
    with pytest.raises(ValueError, match=r"200\.png cannot be read as an image"):
        made(folder, own_frames)
    assert not list(folder.iterdir())


def test_few_frames_and_frames_that_are_no_files_are_not_kept(frames: list[Path], folder: Path) -> None:
    few, none = Images.from_files(frames[:255]), Images.from_arrays(list(Images.from_files(frames)))
    for shown in (few, none, few[:0]):
        NORMALISE(Preprocessed(folder, 1).kept(shown))
    assert not folder.exists()
    made(folder, frames[:256])
    assert len(list(folder.glob("*.npy"))) == 1


WORKER = """
import sys
from pathlib import Path
from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation
from vprbench.run.preprocessed import Preprocessed
paths = sorted(Path(sys.argv[2]).iterdir())
print("ready", flush=True)
sys.stdin.readline()
for _ in range(5):
    levels = PatchNormalisation("C", 6, 8, 3)(Preprocessed(Path(sys.argv[1]), 1).kept(Images.from_files(paths)))
    print(levels.tobytes().hex())
"""


def test_processes_at_the_same_time_all_get_the_levels(frames: list[Path], folder: Path) -> None:
    command = [sys.executable, "-c", WORKER, str(folder), str(frames[0].parent)]
    workers = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    for worker in workers:
        assert worker.stdout is not None
        assert worker.stdout.readline() == "ready\n"
    expected = NORMALISE(Images.from_files(frames)).tobytes().hex()
    for worker in workers:
        assert worker.stdin is not None
        worker.stdin.write("go\n")
        worker.stdin.flush()
    for worker in workers:
        assert worker.communicate()[0].split() == [expected] * 5
        assert worker.returncode == 0
    assert sorted(path.suffix for path in folder.iterdir()) == [".json", ".npy"]


# Honest seconds


@dataclass
class Matching(Method):
    """Compares patch-normalised frames, after a fit that computes for 2 s; calibrates by looking at both sides."""

    clock: Clock
    by_held_out: bool = False

    @property
    def calibrates(self) -> bool:
        return self.by_held_out

    def fit(self, references: Images, places: Places) -> Self:
        self.references = self.encode(references).astype(int)
        self.clock.spend(2)
        return self

    def calibrate(self, held_out: HeldOut) -> Self:
        self.encode(held_out.references)
        self.encode(held_out.queries)
        return self

    def encode(self, images: Images) -> npt.NDArray[np.uint8]:
        return NORMALISE(images)

    def match(self, codes: npt.NDArray[np.uint8]) -> Scores:
        return -np.abs(codes[:, None].astype(int) - self.references).mean(2).astype(np.float32)


@pytest.fixture(scope="module", autouse=True)
def surroundings() -> Iterator[None]:
    with quiet_surroundings():
        yield


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock on which a frame takes 10 ms to read and 1 ms to be normalised."""
    clock = Clock()
    clock.replaces_those_of([runner, images, preprocessed], monkeypatch)
    monkeypatch.setattr(images, "ThreadPoolExecutor", ReadersThatWait)
    monkeypatch.setattr(preprocess.torch, "get_num_threads", lambda: 1)  # or normalising goes on while one reads
    reading, normalising = images.read_image, PatchNormalisation._fused

    def read(path: Path) -> npt.NDArray[np.uint8]:
        clock.spend(0.01)
        return reading(path)

    def normalise(self: PatchNormalisation, block: Any, levels: Any) -> None:
        clock.spend(0.001 * len(block))
        normalising(self, block, levels)

    monkeypatch.setattr(images, "read_image", read)
    monkeypatch.setattr(preprocess.PatchNormalisation, "_fused", normalise)
    return clock


def dataset(frames: list[Path]) -> Dataset:
    queries = journey(8, N_IMAGES)
    return replace(queries, references=Images.from_files(frames))


def run(method: Method, data: Dataset, folder: Path | None) -> Run:
    kept = None if folder is None else Preprocessed(folder, 1)
    return runner.run("little", method, data, CONFIG, "key", "fingerprint", QUICK, 1, preprocessed=kept)


def test_the_seconds_that_frames_from_the_cache_once_took_are_part_of_the_fit(
    frames: list[Path], folder: Path, clock: Clock
) -> None:
    runs = [run(Matching(clock), dataset(frames), where) for where in (None, folder, folder)]
    for each in runs:
        assert each.fit_seconds == pytest.approx(0.011 * N_IMAGES + 2)
        assert each.fit_compute_seconds == pytest.approx(0.001 * N_IMAGES + 2)
    assert runs[0].scores is not None
    for each in runs[1:]:
        np.testing.assert_array_equal(each.scores, runs[0].scores)


class AtOnce(ReadersThatWait):
    """Does what it is asked for at once."""

    def submit(self, call: Any, *arguments: Any) -> SimpleNamespace:
        call(*arguments)
        return SimpleNamespace(done=lambda: True, result=lambda: None)


def test_what_a_second_thread_computes_while_the_first_waits_for_images_is_computing(
    frames: list[Path], folder: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    worked = Clock()  # of the second thread, which does all its work while the first one waits

    def normalise(self: PatchNormalisation, block: Any, levels: Any) -> None:
        worked.spend(0.004 * len(block))
        self._readable(block, levels)

    monkeypatch.setattr(preprocess.PatchNormalisation, "_fused", normalise)
    monkeypatch.setattr(preprocess.torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(preprocess, "ThreadPoolExecutor", AtOnce)
    times = SimpleNamespace(perf_counter=clock.seconds, thread_time=worked.seconds)
    monkeypatch.setattr(preprocess, "time", times)
    for where in (None, folder, folder):
        made = run(Matching(clock), dataset(frames), where)
        assert made.fit_seconds == pytest.approx(0.01 * N_IMAGES + 2)
        assert made.fit_compute_seconds == pytest.approx(0.004 * N_IMAGES / 2 + 2)


def test_the_run_says_which_seconds_are_not_its_own(frames: list[Path], folder: Path, clock: Clock) -> None:
    notes = [[note.text for note in run(Matching(clock), dataset(frames), folder).notes] for _ in range(2)]
    assert not any("cache" in note for note in notes[0])
    (note,) = (note for note in notes[1] if "cache" in note)
    assert note == (
        "260 preprocessed frames were taken from the cache: the 2.9 s that reading and preprocessing them took when "
        "they were made are counted"
    )


def test_the_time_of_the_method_and_of_the_harness_are_those_of_this_run(
    frames: list[Path], folder: Path, clock: Clock
) -> None:
    first, second = (run(Matching(clock), dataset(frames), folder) for _ in range(2))
    assert first.method_seconds - second.method_seconds == pytest.approx(0.001 * N_IMAGES)
    assert second.harness_seconds == pytest.approx(first.harness_seconds)


def test_held_out_places_are_kept_too(frames: list[Path], folder: Path, clock: Clock, read: list[Path]) -> None:
    aside = Images.from_files(frames[:256])
    places = np.arange(256)
    data = replace(dataset(frames), held_out=HeldOut(aside, places, Images.from_files(frames[2:258]), places, True))
    first = run(Matching(clock, by_held_out=True), data, folder)
    n_read = len(read)
    second = run(Matching(clock, by_held_out=True), data, folder)
    assert len(read) == n_read == N_IMAGES + 256 + 256
    assert second.fit_seconds == pytest.approx(first.fit_seconds)
    assert second.fit_compute_seconds == pytest.approx(first.fit_compute_seconds)


def test_the_command_line_keeps_frames_beside_its_runs_unless_told_not_to(
    frames: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    road, results = frames[0].parent, tmp_path / "results"
    asked = ["method=sad", "dataset=folders", f"dataset.references=[{road}]", f"dataset.queries={road}", "threads=1"]
    asked += ["frames=false", "timing.minimum_seconds=0", "timing.sample=2", "timing.batch_sizes=[1]", "force=true"]
    asked += ["timing.minimum_queries=2", f"results={results}", "output=json"]
    notes = []
    for option in ("cache=false", "cache=true", "cache=true", "cache=false"):
        assert main([*asked, option]) == 0
        notes.append(" ".join(note["text"] for note in json.loads(capsys.readouterr().out)["notes"]))
        assert (results / "preprocessed").exists() == (len(notes) > 1)
    assert ["preprocessed frames were taken from the cache" in each for each in notes] == [False, False, True, False]


def test_beside_the_levels_stands_what_they_came_from_and_what_they_took(
    frames: list[Path], folder: Path, clock: Clock
) -> None:
    made(folder, frames)
    (path,) = folder.glob("*.json")
    about = json.loads(path.read_text())
    assert about["arguments"] == {"variant": "C", "engine": "fused", **SMALL}
    assert about["images"] == Images.from_files(frames).content_hash()
    assert (about["seconds"], about["reading_seconds"]) == pytest.approx((0.011 * N_IMAGES, 0.01 * N_IMAGES))
    assert about["bytes"] == N_IMAGES * 6 * 8
