"""A second run on the same traverses encodes nothing but the timed sample, answers the same, and says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from little import journey, number_in
from little_runs import kinds

from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.run import descriptors, runner
from vprbench.run.identity import Request
from vprbench.run.record import Run
from vprbench.run.stopwatch import Protocol, Stopwatch

N_QUERIES, N_PLACES = 70, 80
PROTOCOL = Protocol(minimum_seconds=0, minimum_queries=2, sample=2, warmup_queries=1, batch_sizes=[1])


@dataclass(kw_only=True)
class Counting(DescriptorMethod):
    """Describes an image by the angle that stands for its number, and counts the images that it was shown."""

    turn: float = 0.03
    encoded: int = field(default=0, init=False, compare=False)

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        self.encoded += len(images)
        angles = np.array([number_in(image) for image in images]) * self.turn
        return np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)

    def keeps_descriptors(self) -> bool:
        return True


@dataclass(kw_only=True)
class Learning(Counting):
    """Learns its encoder from the references, so that its descriptors are nobody else's."""

    def keeps_descriptors(self) -> bool:
        return False


@dataclass(kw_only=True)
class Weighted(Counting):
    """Has a file of weights."""

    weights: Weights


@pytest.fixture
def dataset() -> Dataset:
    return journey(N_QUERIES, N_PLACES, [[i] for i in range(N_QUERIES)])


def run(method: DescriptorMethod, dataset: Dataset, folder: Path | None, **changes: Any) -> Run:
    arguments = {
        "_target_": "Counting",
        "turn": 0.03,
        "index": "exact",
        "device": "cpu",
        **changes.pop("arguments", {}),
    }
    config = {"method": arguments, "seed": 0, "device": "cpu", "depth": 5, "overrides": [], "files": [], **changes}
    return runner.run(Request("counting", method, dataset, config, "fingerprint", PROTOCOL, 1, cache=folder), "key")


def encoded_for_answers(method: Counting, run: Run) -> int:
    """The images that were encoded, without the first query and the timing: each lap, warm-up and audit show one."""
    without = Counting()
    without.fit_descriptors(np.eye(2, dtype=np.float32), np.arange(2))
    Stopwatch(PROTOCOL).measure(without, journey(N_QUERIES, 2, [[0]] * N_QUERIES).queries)
    return method.encoded - 1 - without.encoded


@pytest.mark.parametrize(("kind", "cached", "files"), [(Counting, True, 2), (Counting, False, 0), (Learning, True, 0)])
def test_the_first_run_encodes_every_image_once_and_keeps_what_is_worth_keeping(
    dataset: Dataset, tmp_path: Path, kind: type[Counting], cached: bool, files: int
) -> None:
    method = kind()
    found = run(method, dataset, tmp_path if cached else None)
    assert encoded_for_answers(method, found) == N_QUERIES + N_PLACES
    assert found.fit_seconds is not None
    assert len(list(tmp_path.glob("*/*.npy"))) == files
    assert "described" not in kinds(found)


def test_the_second_run_encodes_nothing_for_its_answers_and_says_so(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    found = run(method, dataset, tmp_path)
    assert encoded_for_answers(method, found) == 0
    assert found.fit_seconds is None
    assert found.load_seconds is not None
    plain = run(Counting(), dataset, None)
    assert plain.scores is not None
    assert np.array_equal(plain.scores, found.scores)
    assert (plain.outcome.above == 0).all()
    (note,) = [note.text for note in found.notes if note.kind == "described"]
    assert note == (
        f"descriptors of {N_PLACES} references and {N_QUERIES} queries were kept from an earlier run: "
        "nothing was encoded but the timed sample"
    )


def with_another_last_bit(dataset: Dataset) -> Dataset:
    """Return the dataset with one image changed in its last pixel, which a glance at some of them leaves out."""
    arrays = [image.copy() for image in dataset.references]
    arrays[50][2, 3, 2] ^= 1
    return replace(dataset, references=Images.from_arrays(arrays, dataset.references.names))


def renamed(dataset: Dataset) -> Dataset:
    names = [f"other {i}" for i in range(N_PLACES)]
    return replace(dataset, references=Images.from_arrays(list(dataset.references), names))


@pytest.mark.parametrize(
    ("method", "of", "changes", "encoded"),
    [
        (Counting(index="hnsw"), lambda dataset: dataset, {"arguments": {"index": "hnsw"}}, 0),
        (Counting(), lambda dataset: dataset, {"arguments": {"turn": 0.02}}, N_QUERIES + N_PLACES),
        (Counting(), lambda dataset: dataset, {"files": [["weights.pth", "ab" * 32]]}, N_QUERIES + N_PLACES),
        (Counting(), with_another_last_bit, {}, N_PLACES),
        (Counting(), renamed, {}, 0),
        (Counting(), lambda _: journey(40, N_PLACES, [[i] for i in range(40)]), {}, 40),
    ],
    ids=["index", "argument", "weights", "changed image", "names", "other queries"],
)
def test_a_second_run_encodes_what_is_not_kept_under_its_arguments_weights_and_images(
    dataset: Dataset,
    tmp_path: Path,
    method: Counting,
    of: Callable[[Dataset], Dataset],
    changes: dict[str, Any],
    encoded: int,
) -> None:
    run(Counting(), dataset, tmp_path)
    found = run(method, of(dataset), tmp_path, **changes)
    assert encoded_for_answers(method, found) == encoded
    notes = [note.text for note in found.notes if note.kind == "described"]
    assert len(notes) == (encoded < N_QUERIES + N_PLACES)
    if encoded == 40:
        assert notes[0].startswith(f"descriptors of {N_PLACES} references were kept from an earlier run: none of these")


def test_where_a_file_of_weights_lies_does_not_count(dataset: Dataset, tmp_path: Path) -> None:
    for path, encoded in (("here", N_QUERIES + N_PLACES), ("there", 0)):
        method = Weighted(weights=Weights(file="w", licence="", trained_on="", path=path))
        files = [[path, "ab" * 32]]
        found = run(method, dataset, tmp_path, arguments={"weights": {"path": path}}, files=files)
        assert encoded_for_answers(method, found) == encoded


@pytest.mark.parametrize(
    ("module", "name"), [(descriptors, "source_hash"), (descriptors.machine, "device_class")], ids=["code", "device"]
)
def test_other_code_and_another_device_encode_anew(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str
) -> None:
    run(Counting(), dataset, tmp_path)
    monkeypatch.setattr(module, name, lambda _: "another")
    method = Counting()
    assert encoded_for_answers(method, run(method, dataset, tmp_path)) == N_QUERIES + N_PLACES


def test_an_index_that_cannot_be_made_is_refused_before_anything_is_encoded(dataset: Dataset, tmp_path: Path) -> None:
    for folder in (None, tmp_path):
        method = Counting(index="ivfpq")
        with pytest.raises(BadInput, match=r"ivfpq .* 256 .* 80 came"):
            run(method, dataset, folder)
        assert method.encoded == 0
