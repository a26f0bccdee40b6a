"""The rules for methods: each is a function that raises RuleBrokenError with the values that break it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from safetensors import numpy as safetensors

from vprbench.api.arrays import Image, Places, Scores
from vprbench.api.images import Images
from vprbench.api.method import Method, require_codes
from vprbench.errors import NotFittedError
from vprbench.plugins.networks import keeps_a_network
from vprbench.storage.tensors import require_plain_numbers

N_PLACES = 20
_RELATIVE = 1e-4  # difference in score, relative to the largest, that counts as rounding

ENCODE_RULE = "encode returns one array whose first axis is the image"


class RuleBrokenError(AssertionError):
    """A method or dataset broke a rule; the message holds the values."""


def require(kept: Any, message: str) -> None:
    """Raise RuleBrokenError unless a rule is kept."""
    if not kept:
        raise RuleBrokenError(message)


@dataclass(frozen=True)
class Journey:
    """A drawn world: 20 places, two reference traverses, and queries of six of the places."""

    references: list[Image]
    places: Places  # (n_references,)
    queries: list[Image]
    right: Places  # (n_queries,), the place of each query

    @classmethod
    def draw(cls, seed: int = 0) -> Journey:
        """Draw another world for another seed."""
        generator = np.random.default_rng(seed)
        coarse = generator.integers(0, 256, (N_PLACES, 6, 8, 3), dtype=np.uint8)
        scenes = [np.asarray(cv2.resize(scene, (64, 48), interpolation=cv2.INTER_CUBIC), np.uint8) for scene in coarse]

        def see(place: int) -> Image:
            noise = generator.integers(-12, 13, scenes[place].shape)
            return np.asarray(np.clip(scenes[place].astype(np.int64) + noise, 0, 255), np.uint8)

        right = np.array([0, 3, 7, 12, 18, 19])
        references = [see(place) for _ in range(2) for place in range(N_PLACES)]
        return cls(references, np.tile(np.arange(N_PLACES), 2), [see(place) for place in right.tolist()], right)


class Subject:
    """A method that is put to the rules: a function that makes a new one, and the arguments that it passes."""

    def __init__(self, make: Callable[[], Method], arguments: Mapping[str, Any]) -> None:
        self.make, self.arguments = make, arguments
        world = Journey.draw()  # which rules only read
        self.references, self.places = Images.from_arrays(world.references), world.places
        self.queries = Images.from_arrays(world.queries)

    def fit_new(self, seed: int = 0) -> Method:
        """Return a new method that has learnt the world of a seed, whatever `fit` returns."""
        method, world = self.make(), Journey.draw(seed)
        method.fit(Images.from_arrays(world.references), world.places)
        return method

    @cached_property
    def shared(self) -> Method:
        """A method that has learnt the first world, for rules that fit nothing else."""
        return self.fit_new()

    @cached_property
    def scores(self) -> Scores:
        """The scores of the queries by `shared`, an array of its own."""
        return np.array(self.shared.query(self.queries), copy=True)


def _check_arguments_stored(subject: Subject) -> None:
    method = subject.make()
    for name, value in subject.arguments.items():
        stored = getattr(method, name, "not stored")
        require(stored == value, f"argument {name}={value} is {stored} after construction")


def _check_codes(subject: Subject) -> None:
    for images in subject.queries, subject.queries[:1]:
        require_codes(subject.shared.encode(images), len(images))


def _check_second_fit(subject: Subject) -> None:
    method, world = subject.fit_new(seed=1), Journey.draw(2)
    returned: object = method.fit(Images.from_arrays(world.references), world.places)
    require(returned is method, f"fit returned a {type(returned).__name__}: end it with return self")
    fresh, queries = subject.fit_new(seed=2), Images.from_arrays(world.queries)
    _require_same(method.query(queries), fresh.query(queries), "after an earlier fit the scores differ")


def _check_unfitted(subject: Subject) -> None:
    try:
        subject.make().query(subject.queries)
    except NotFittedError:
        return
    require(False, "query before fit raised no NotFittedError")


def _check_arrays_unchanged(subject: Subject) -> None:
    world, method = Journey.draw(), subject.make()
    with _require_unchanged("place ids", world.places), _require_unchanged("images", *world.references, *world.queries):
        method.fit(Images.from_arrays(world.references), world.places)
        codes = method.encode(Images.from_arrays(world.queries[:3]))
        with _require_unchanged("codes", codes):
            scores = method.match(codes)
            with _require_unchanged("the scores that match returned", scores):
                method.match(method.encode(Images.from_arrays(world.queries[3:])))


def _check_seed(subject: Subject) -> None:
    same = np.array_equal(subject.scores, subject.fit_new().query(subject.queries))
    require(same, "two fits with the same arguments give different scores")


def _check_batches(subject: Subject) -> None:
    single = np.concatenate([subject.shared.query(subject.queries[i : i + 1]) for i in range(len(subject.queries))])
    _require_same(subject.scores, single, "a batch gives other scores than its images one by one")


def _excuse_adaptation(subject: Subject) -> str:
    adapt = subject.make().adapt
    return f"adapt={adapt} takes the mean of other queries off each query" if adapt in ("running", "traverse") else ""


def _check_scores(subject: Subject) -> None:
    scores: Any = subject.shared.query(subject.queries)
    shape, kind, wanted = np.shape(scores), getattr(scores, "dtype", type(scores)), (len(subject.queries), N_PLACES)
    right = isinstance(scores, np.ndarray) and (shape, kind) == (wanted, np.float32)
    require(right, f"{shape} {kind}; wanted {wanted} float32")
    _require_candidates(scores, "scores are not finite")


def _check_direction(subject: Subject) -> None:
    known = subject.shared.query(subject.references[:N_PLACES])
    right = np.count_nonzero(known.argmax(1) == np.arange(N_PLACES))
    require(2 * right > N_PLACES, f"only {right} of {N_PLACES} reference images score highest at their own place")


def _check_any_image(subject: Subject) -> None:
    world, method = Journey.draw(), subject.make()
    black, larger = np.zeros_like(world.queries[0]), np.asarray(cv2.resize(world.queries[0], (96, 80)), np.uint8)
    method.fit(Images.from_arrays([black, *world.references[1:]]), world.places)
    scores = method.query(Images.from_arrays([larger, black]))
    _require_candidates(scores, "scores of a black image and one of another size are not finite")


def _check_stored(subject: Subject) -> None:
    trained = subject.fit_new()
    scores = trained.query(subject.queries)
    stored = safetensors.save({name: require_plain_numbers(array, name) for name, array in trained.state().items()})
    require(np.array_equal(trained.query(subject.queries), scores), "storing a network changes its scores")
    for method, kind in ((subject.make(), "new"), (subject.fit_new(seed=1), "fitted elsewhere before")):
        method.restore(safetensors.load(stored))
        same = np.array_equal(method.query(subject.queries), scores)
        require(same, f"restored into a method {kind} it gives other scores")


def _excuse_without_network(subject: Subject) -> str:
    return "" if keeps_a_network(subject.make()) else "it keeps no network"


def _check_extended(subject: Subject) -> None:
    method = subject.make()
    images, places, first_new = subject.references, subject.places, N_PLACES * 3 // 4
    known, new = np.flatnonzero(places < first_new), np.flatnonzero(places >= first_new)
    method.fit(images[known], places[known])
    scores = method.query(subject.queries)
    with _require_unchanged("the scores that match returned", scores):
        for place in range(first_new, N_PLACES):
            own = np.flatnonzero(places == place)
            method.extend(images[own], places[own])
    after = method.query(subject.queries)[:, :first_new]
    _require_same(scores, after, "learning more places changes the scores of known ones")
    right = np.count_nonzero(method.query(images[new])[:, first_new:].argmax(1) == places[new] - first_new)
    complaint = f"only {right} of {len(new)} images of new places score highest at their own among these"
    require(2 * right > len(new), complaint)


def _excuse_without_extend(subject: Subject) -> str:
    return "" if subject.make().extends else "it learns no place after fit"


def _check_spikes(subject: Subject) -> None:
    method = subject.fit_new()
    scores, codes = method.query(subject.queries), method.encode(subject.queries)
    with _require_unchanged("codes", codes):
        layers = list(method.spikes(codes))
    for layer in layers:
        shape, wanted = np.shape(layer.values), f"({len(codes)}, n_neurons)"
        right = len(shape) == 2 and shape[0] == len(codes)
        right = right and np.isfinite(layer.values).all() and (layer.values >= 0).all()
        require(right, f"layer {layer.name} has spikes of shape {shape}; wanted {wanted}, finite and 0 or more")
    names = [layer.name for layer in layers]
    require(all(names) and len(set(names)) == len(names), f"layers named {names}; wanted a name each")
    require(np.array_equal(method.query(subject.queries), scores), "counting spikes changes later scores")


@contextmanager
def _require_unchanged(name: str, *arrays: Any) -> Iterator[None]:
    """Require that the block changes none of some arrays."""
    before = [np.array(array, copy=True) for array in arrays]
    yield
    same = all(np.array_equal(np.asarray(array), copy) for array, copy in zip(arrays, before, strict=True))
    require(same, f"a call changes {name}: work on a copy, and return an array of its own")


def _require_candidates(scores: Scores, complaint: str) -> None:
    """Require numbers, or -inf for a place that is no candidate, and at least one candidate a query."""
    wrong = np.count_nonzero(~np.isfinite(scores) & ~np.isneginf(scores))
    require(not wrong, f"{wrong} {complaint}")
    require(not np.isneginf(scores).all(axis=1).any(), "a query has no candidate: all its scores are -inf")


def _require_same(scores: Scores, others: Scores, complaint: str) -> None:
    """Require the same scores but for rounding, and the same candidates."""
    scale = float(np.abs(scores[np.isfinite(scores)]).max(initial=0))
    same = np.allclose(scores, others, rtol=0, atol=_RELATIVE * scale)
    require(same, f"{complaint}, by more than {_RELATIVE:g} of the largest, {scale:.2g}")


@dataclass(frozen=True)
class Rule:
    """A function that raises RuleBrokenError, and one that says why a method need not keep the rule; empty: it must."""

    check: Callable[[Subject], None]
    excuse: Callable[[Subject], str] = lambda subject: ""


#: The rules by the text that `check` prints, in its order.
RULES: dict[str, Rule] = {
    "the constructor only stores its arguments": Rule(_check_arguments_stored),
    ENCODE_RULE: Rule(_check_codes),
    "fit forgets an earlier fit and returns the method": Rule(_check_second_fit),
    "query before fit raises NotFittedError": Rule(_check_unfitted),
    "arrays that were given or returned are never modified": Rule(_check_arrays_unchanged),
    "the same seed gives the same scores": Rule(_check_seed),
    "a batch gives what its single images give": Rule(_check_batches, _excuse_adaptation),
    "scores are finite float32 of shape (n_queries, n_places)": Rule(_check_scores),
    "higher scores mean more alike": Rule(_check_direction),
    "black images and images of other sizes are accepted": Rule(_check_any_image),
    "a stored network answers as the trained one": Rule(_check_stored, _excuse_without_network),
    "places learnt after fit are scored and change no score of known ones": Rule(
        _check_extended, _excuse_without_extend
    ),
    "spikes are counts or amplitudes by layer and query": Rule(_check_spikes),
}
