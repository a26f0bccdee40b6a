"""A second run on the same traverses encodes nothing but the timed sample, answers the same, and says so."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from little import journey, number_in

from vprbench import runner
from vprbench.descriptor_cache import DescriptorCache
from vprbench.images import Images
from vprbench.interface import Dataset, DescriptorMethod
from vprbench.records import Run
from vprbench.stopwatch import Protocol, Stopwatch

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
    config = {"method": arguments, "seed": 0, "device": "cpu", "depth": 5, "overrides": [], "files": {}, **changes}
    cache = None if folder is None else DescriptorCache(folder)
    return runner.run("counting", method, dataset, config, "key", "fingerprint", PROTOCOL, 1, cache=cache)


def encoded_for_answers(method: Counting, run: Run) -> int:
    """The images that were encoded, those of the timing left out: each lap of it, warm-up and audit show one."""
    without = Counting()
    without.fit_descriptors(np.eye(2, dtype=np.float32), np.arange(2))
    Stopwatch(PROTOCOL).measure(without, journey(N_QUERIES, 2, [[0]] * N_QUERIES).queries)
    return method.encoded - without.encoded


def test_without_a_cache_every_image_is_encoded(dataset: Dataset) -> None:
    method = Counting()
    found = run(method, dataset, None)
    assert encoded_for_answers(method, found) == N_QUERIES + N_PLACES
    assert found.fit_seconds is not None


def test_the_first_run_encodes_every_image_once_and_keeps_what_it_found(dataset: Dataset, tmp_path: Path) -> None:
    method = Counting()
    found = run(method, dataset, tmp_path)
    assert encoded_for_answers(method, found) == N_QUERIES + N_PLACES
    assert found.fit_seconds is not None
    assert len(list(tmp_path.glob("*.npy"))) == 2
    assert not any("descriptors" in note for note in found.notes)


def test_the_second_run_encodes_nothing_for_its_answers_and_says_so(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    found = run(method, dataset, tmp_path)
    assert encoded_for_answers(method, found) == 0
    assert found.fit_seconds is None
    assert found.load_seconds is not None
    (note,) = [note for note in found.notes if "descriptors" in note]
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
    "changes", [{"arguments": {"turn": 0.02}}, {"files": {"weights.pth": "ab" * 32}}], ids=["argument", "weights"]
)
def test_other_arguments_and_other_weights_are_encoded_anew(
    dataset: Dataset, tmp_path: Path, changes: dict[str, Any]
) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    assert encoded_for_answers(method, run(method, dataset, tmp_path, **changes)) == N_QUERIES + N_PLACES


def test_other_queries_of_the_same_map_are_all_that_is_encoded(dataset: Dataset, tmp_path: Path) -> None:
    run(Counting(), dataset, tmp_path)
    method = Counting()
    found = run(method, journey(40, N_PLACES, [[i] for i in range(40)]), tmp_path)
    assert encoded_for_answers(method, found) == 40
    (note,) = [note for note in found.notes if "descriptors" in note]
    assert note.startswith(f"descriptors of {N_PLACES} references were kept from an earlier run: none of these was")


def test_descriptors_that_a_method_learns_with_its_map_are_not_kept(dataset: Dataset, tmp_path: Path) -> None:
    run(Learning(), dataset, tmp_path)
    assert not list(tmp_path.iterdir())
