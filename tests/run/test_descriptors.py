"""A second run on the same traverses encodes nothing but the timed sample, answers the same, and says so."""

from __future__ import annotations

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
    assert len(list(tmp_path.glob("*.npy"))) == files
    assert "described" not in kinds(found)


def test_the_second_run_encodes_nothing_for_its_answers_and_says_so(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    found = run(method, dataset, tmp_path)
    assert encoded_for_answers(method, found) == 0
    assert found.fit_seconds is None
    assert found.load_seconds is not None
    (note,) = [note.text for note in found.notes if note.kind == "described"]
    assert note == (
        f"descriptors of {N_PLACES} references and {N_QUERIES} queries were kept from an earlier run: "
        "nothing was encoded but the timed sample"
    )


def test_both_runs_give_the_answers_of_a_run_without_a_cache(dataset: Dataset, tmp_path: Path) -> None:
    runs = [run(Counting(), dataset, folder) for folder in (None, tmp_path, tmp_path)]
    scores = [found.scores for found in runs]
    assert scores[0] is not None
    assert all(np.array_equal(scores[0], other) for other in scores)
    assert (runs[0].outcome.above == 0).all()


def test_another_index_takes_the_same_descriptors(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting(index="hnsw")
    found = run(method, dataset, tmp_path, arguments={"index": "hnsw"})
    assert encoded_for_answers(method, found) == 0


@pytest.mark.parametrize(
    "changes",
    [{"arguments": {"turn": 0.02}}, {"files": [["weights.pth", "ab" * 32]]}],
    ids=["argument", "weights"],
)
def test_other_arguments_and_other_weights_are_encoded_anew(
    dataset: Dataset, tmp_path: Path, changes: dict[str, Any]
) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    assert encoded_for_answers(method, run(method, dataset, tmp_path, **changes)) == N_QUERIES + N_PLACES


def test_images_that_changed_under_their_names_are_encoded_anew(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    arrays = [image.copy() for image in dataset.references]
    arrays[50][2, 3, 2] ^= 1  # one that a glance at some of them leaves out, in its last pixel
    changed = replace(dataset, references=Images.from_arrays(arrays, dataset.references.names))
    method = Counting()
    assert encoded_for_answers(method, run(method, changed, tmp_path)) == N_PLACES


def test_the_same_images_under_other_names_are_not_encoded_again(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    renamed = Images.from_arrays(list(dataset.references), [f"other {i}" for i in range(N_PLACES)])
    method = Counting()
    assert encoded_for_answers(method, run(method, replace(dataset, references=renamed), tmp_path)) == 0


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


def test_where_a_file_of_weights_lies_does_not_count(dataset: Dataset, tmp_path: Path) -> None:
    def weighted(path: str) -> Weighted:
        return Weighted(weights=Weights(file="w", licence="", trained_on="", path=path))

    files = [["w", "ab" * 32]]
    run(weighted("here"), dataset, tmp_path, arguments={"weights": {"path": "here"}}, files=files)
    method = weighted("there")
    found = run(method, dataset, tmp_path, arguments={"weights": {"path": "there"}}, files=[["v", "ab" * 32]])
    assert encoded_for_answers(method, found) == 0


def test_an_index_that_cannot_be_made_is_refused_before_anything_is_encoded(dataset: Dataset, tmp_path: Path) -> None:
    for folder in (None, tmp_path):
        method = Counting(index="ivfpq")
        with pytest.raises(BadInput, match="ivfpq needs at least 256 reference images, 80 came"):
            run(method, dataset, folder)
        assert method.encoded == 0


def test_other_queries_of_the_same_map_are_all_that_is_encoded(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    found = run(method, journey(40, N_PLACES, [[i] for i in range(40)]), tmp_path)
    assert encoded_for_answers(method, found) == 40
    (note,) = [note.text for note in found.notes if note.kind == "described"]
    assert note.startswith(f"descriptors of {N_PLACES} references were kept from an earlier run: none of these was")
