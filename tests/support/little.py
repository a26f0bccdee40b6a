"""A method, a dataset and a stored run small enough to work by hand, and what other processes do to a store."""

import os
import signal
import sys
from dataclasses import asdict, dataclass, field, replace
from itertools import count
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput, NotFittedError
from vprbench.metrics.ranking import Outcome, judge_scores, rank_places
from vprbench.plugins import networks
from vprbench.runs.notes import Note
from vprbench.runs.record import Failure, Run
from vprbench.runs.stopwatch import Laps, Protocol, Timing
from vprbench.runs.store import Store


def picture(number):
    """Return an image that carries `number`, 0 to 16383, in its first pixel; the lowest bits mean nothing."""
    image = np.full((3, 4, 3), 100, np.uint8)
    image[0, 0, :2] = np.multiply(divmod(number, 128), 2)
    return image


def number_in(image):
    return int(image[0, 0, 0]) // 2 * 128 + int(image[0, 0, 1]) // 2


def pictures(numbers, lowest_bit=0):
    return Images.from_arrays([picture(number) + np.uint8(lowest_bit) for number in numbers])


def numbers_in(images):
    return [number_in(image) for image in images]


@dataclass
class Angles(DescriptorMethod):
    """Describes image number i by cosines of i, in 16 dimensions; images of every 20th number look alike."""

    distinct: int = 20

    def encode(self, images):
        numbers = np.array(numbers_in(images)) % self.distinct
        vectors = np.cos(numbers[:, None] * np.arange(1, 17) + np.arange(16))
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)


@dataclass
class Lookup(Method):
    """Answers query number i with row i of a table of scores."""

    table: Scores  # (n_queries, n_places)
    asked: list[list[int]] = field(default_factory=list)  # the numbers of the images of each call

    def fit(self, references, places):
        return self

    def encode(self, images):
        numbers = numbers_in(images)
        self.asked.append(numbers)
        return np.array(numbers)

    def match(self, codes):
        return self.table[codes]


@dataclass
class Prototypes(Method):
    """Learns of each place the mean of its images, disturbed by noise from the seed; `contrast` acts at the query."""

    noise: float = 0.5
    contrast: float = 1.0
    seed: int = 0
    device: str = "cpu"

    query_arguments: ClassVar[frozenset[str]] = frozenset({"contrast"})

    _means: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references, places):
        codes = self.encode(references)
        means = np.stack([codes[places == place].mean(0) for place in range(int(places.max()) + 1)])
        noise = np.random.default_rng(self.seed).normal(size=means.shape).astype(np.float32)
        self._means = means + np.float32(self.noise) * noise
        return self

    def encode(self, images):
        return np.array([[*image[0, 0, :2], image.mean(), image.std()] for image in images], np.float32)

    def match(self, codes):
        return -np.float32(self.contrast) * np.abs(codes[:, None] - self.state()["means"]).mean(2)

    def state(self):
        if self._means is None:
            raise NotFittedError("Prototypes has learnt nothing yet")
        return {"means": self._means}

    def restore(self, state):
        if set(state) != {"means"}:
            raise BadInput(f"{', '.join(sorted(state))} came; wanted means")
        self._means = state["means"]
        return self


def journey(n_queries, n_places, positives=None):
    """Return a dataset whose query i is picture(i); unless told otherwise its right place is i modulo n_places."""
    right = [[i % n_places] for i in range(n_queries)] if positives is None else positives
    return Dataset(
        name="journey",
        references=pictures(range(n_places)),
        places=np.arange(n_places),
        queries=pictures(range(n_queries), lowest_bit=1),  # no copies
        positives=tuple(np.array(row, np.int64) for row in right),
        protocol={"queries": "dusk", "tolerance_places": 0},
    )


def slow_pictures(count, seconds, sleep):
    """Return images each of which takes `seconds` to read."""

    def read(i):
        sleep(seconds)
        return picture(i)

    return Images(read, [f"{i}.png" for i in range(count)])


def laps(encode_seconds, match_seconds, images_per_call=1):
    return Laps(np.array(encode_seconds), np.array(match_seconds), images_per_call, True)


def a_layer(*values):
    names = ("name", "neurons", "spikes_per_query", "active_share", "amplitude_mean")
    return dict(zip(names, values, strict=True))


def a_run(**changes):
    """Return a run of four queries and ten places; its right places stand 1st, 1st, 3rd and 8th.

    Streaming takes 10 ms to encode and 2.5 ms to match; a batch of eight takes 40 ms and 10 ms.
    """
    ones, above = np.ones(4, np.int64), np.array([0, 0, 2, 7])
    scores = np.array([[0.9, 0.1], [0.8, 0.2], [0.7, 0.3], [0.6, 0.4]], np.float32)
    layers = [
        a_layer("input", 12, [9.0, 8.0, 10.0, 9.0], 1.0, 0.25),
        a_layer("feature", 24, [2.0, 3.0, 2.0, 1.0], 0.25, 0.5),
        a_layer("output", 10, [1.0, 1.0, 2.0, 1.0], 0.4, None),
    ]
    seen = {"load_average": [0.5, 0.25, 0.125], "git": None, "time_utc": "2025-01-31T12:00:00Z"}
    run = Run(
        method="little",
        dataset="journey",
        key="0123456789abcdef",
        config={
            "method": {"_target_": "little.Lookup", "window": 5},
            "dataset": {"name": "journey"},
            **{"seed": 3, "device": "cpu", "depth": 2},
            "overrides": ["method=little", "dataset=journey", "method.window=5", "seed=3"],
            "changed": {"window": 5},
            "code": "c0de" * 16,
            "timing": {name: [*v] if isinstance(v, tuple) else v for name, v in asdict(Protocol()).items()},
        },
        protocol={"reference": ["spring", "fall"], "query": "summer", "tolerance_places": 0},
        fingerprint="f" * 64,
        environment={"processor": "Abacus 9", "threads": 1, "cores": 2, "libraries": {"torch": "2.6.0"}} | seen,
        notes=(Note("noisy", "noisy: two carts passed"), Note("dataset", "ünïcode")),
        n_references=20,
        **{"fit_seconds": 12.34, "fit_compute_seconds": 11.5, "load_seconds": None, "network": None},
        search={"index": "hnsw", "bytes_per_place": 4352, "recall_at_1": 0.984375, "recall_at_10": 0.975},
        **{"peak_memory_bytes": 512_000_000, "harness_seconds": 0.125, "method_seconds": 11.75},
        timing=Timing(
            first_query_seconds=0.05,
            warmup_queries=11,
            streaming=laps([0.010] * 5, [0.0025] * 5),
            offline=(laps([0.010] * 4, [0.0025] * 4), laps([0.040] * 3, [0.010] * 3, images_per_call=8)),
            sample=np.arange(4),
            answers=np.array([0, 1, 9, -1]),
        ),
        outcome=Outcome(
            scores[:, 0].copy(), ones, np.array([1, 1, 0, 0]), above, ones, ones, np.array([1, 2, 1, 1]), 10
        ),
        positives=tuple(np.array(right, np.int64) for right in ([0], [1, 5], [2], [3])),
        top_places=np.array([[0, 4], [1, 5], [9, 8], [7, 6]], np.int32),
        top_scores=scores,
        scores=np.arange(40, dtype=np.float32).reshape(4, 10),
        spikes={"queries": 4, "layers": layers},
    )
    return replace(run, **changes)


def answered(table, positives, /, depth=10, **changes):
    """Return a run that gave these scores, (n_queries, n_places)."""
    scores, right = np.asarray(table, np.float32), tuple(np.array(places, np.int64) for places in positives)
    top_places, top_scores = rank_places(scores, depth)
    kept = {"scores": scores, "top_places": top_places, "top_scores": top_scores, "notes": ()}
    return a_run(**{**kept, "positives": right, "outcome": judge_scores(scores, right), **changes})


def a_failure(**changes):
    """Return a failure of the configuration of `a_run`, on the same machine, a day later."""
    run = a_run()
    environment = {**run.environment, "time_utc": "2025-02-01T12:00:00Z"}
    failure = Failure("little", "journey", run.config, "MemoryError: 99 GB wanted", environment, missing=False)
    return replace(failure, **changes)


def unanswerable_run():
    none = dict.fromkeys(("top_tied_correct", "tied", "tied_correct", "n_positives"), np.zeros(4, np.int64))
    outcome = replace(a_run().outcome, above=np.full(4, 10), **none)
    return a_run(positives=(np.empty(0, np.int64),) * 4, outcome=outcome)


def save_keys(root, keys):
    """Save a run under each key, as one of several processes; returns how many were saved."""
    for key in keys:
        Store(root).save(a_run(key=key))
    return len(keys)


def die_before(step):
    """Let this process be killed right before so many steps that change or open something on disk are done."""
    steps = count()

    def die(event, _):
        if event in ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir") and next(steps) == step:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(die)


def replace_and_die(root, step):
    """Replace a stored run, killed before a step."""
    store = Store(root)
    store.save(a_run(n_references=21))
    die_before(step)
    store.save(a_run(n_references=22))


def store_network(path, method, dataset, replace=False, key="0123"):
    """Store the network that `method` has learnt on `dataset` under the arguments it has."""
    arguments = {n: v for n, v in vars(method).items() if not n.startswith("_") and n != "reference_mean"}
    files = networks.Files(save=path, replace=replace)
    networks.require_destination(files, method)
    origin = networks.describe_origin(method, arguments, dataset, key, 12.34)
    networks.save_network(files, method, origin, dataset.references)
