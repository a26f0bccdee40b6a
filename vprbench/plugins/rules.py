"""The rules of the contract: functions of a method that raise RuleBrokenError with the values that break them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from safetensors import numpy as safetensors

from vprbench.api.arrays import Image, Places
from vprbench.api.images import Images
from vprbench.api.method import Method, require_codes
from vprbench.errors import NotFittedError
from vprbench.plugins.networks import keeps_a_network
from vprbench.plugins.registry import check_value
from vprbench.storage.tensors import plain

N_PLACES = 20
_RELATIVE = 1e-4  # difference in score, relative to the largest, that counts as rounding

ENCODE_RULE = "encode returns one array whose first axis is the image"


class RuleBrokenError(AssertionError):
    """A method or dataset broke a rule; the message holds the values."""


class RuleExceptedError(Exception):
    """A method or dataset need not keep a rule; the message says why."""


@dataclass(frozen=True)
class Journey:
    """A small made-up world: 20 places, two reference traverses, and queries of six of the places."""

    references: list[Image]
    places: Places
    queries: list[Image]
    right: npt.NDArray[np.int64]

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

    @property
    def reference_images(self) -> Images:
        """The references as methods get them."""
        return Images.from_arrays(self.references)

    @property
    def query_images(self) -> Images:
        """The queries as methods get them."""
        return Images.from_arrays(self.queries)


@dataclass(frozen=True)
class Subject:
    """A method that is put to the rules: a function that makes a new one, and its arguments."""

    make: Callable[[], Method]
    config: Mapping[str, Any]

    def fit_new(self, world: Journey) -> Method:
        """Return a new method that has learnt a world, whatever `fit` returns."""
        method = self.make()
        method.fit(world.reference_images, world.places)
        return method

    @cached_property
    def shared(self) -> Method:
        """A method that has learnt the first world, for rules that fit nothing else."""
        return self.fit_new(Journey.draw())

    @cached_property
    def scores(self) -> npt.NDArray[np.float32]:
        """The scores of the first world's queries by `shared`, an array of its own."""
        return np.array(self.shared.query(Journey.draw().query_images), copy=True)


def require(kept: Any, message: str) -> None:
    """Raise RuleBrokenError unless a rule is kept."""
    if not kept:
        raise RuleBrokenError(message)


def _check_constructor(subject: Subject) -> None:
    method = subject.make()
    for name, value in subject.config.items():
        stored = getattr(method, name, "not stored")
        wanted = check_value(f"method.{name}", value, type(stored)) if is_dataclass(stored) else value
        same = name == "_target_" or _as_lists(stored) == _as_lists(wanted)
        require(same, f"argument {name}={value} is {stored} after construction")


def _check_codes(subject: Subject) -> None:
    queries = Journey.draw().query_images
    for images in queries, queries[:1]:
        require_codes(subject.shared.encode(images), len(images))


def _check_fit(subject: Subject) -> None:
    method, world = subject.make(), Journey.draw()
    returned: object = method.fit(world.reference_images, world.places)
    require(returned is method, f"fit returned a {type(returned).__name__}: end it with return self")


def _check_second_fit(subject: Subject) -> None:
    first, second = Journey.draw(1), Journey.draw(2)
    method = subject.fit_new(first)
    method.fit(second.reference_images, second.places)
    scores, fresh = method.query(second.query_images), subject.fit_new(second).query(second.query_images)
    _require_same(scores, fresh, "after an earlier fit the scores differ")


def _check_unfitted(subject: Subject) -> None:
    _require_not_fitted(lambda: subject.make().query(Journey.draw().query_images), "query")


def _check_inputs(subject: Subject) -> None:
    world = Journey.draw()
    with _require_unchanged("place ids", world.places), _require_unchanged("images", *world.references, *world.queries):
        method = subject.fit_new(world)
        codes = method.encode(world.query_images)
        with _require_unchanged("codes", codes):
            method.match(codes)


def _check_returned(subject: Subject) -> None:
    method, queries = subject.shared, Journey.draw().query_images
    codes = method.encode(queries[:3])
    with _require_unchanged("the codes that encode returned", codes):
        later = method.encode(queries[3:])
    scores = method.match(codes)
    with _require_unchanged("the scores that match returned", scores):
        method.match(later)


def _check_seed(subject: Subject) -> None:
    world = Journey.draw()
    same = np.array_equal(subject.scores, subject.fit_new(world).query(world.query_images))
    require(same, "two fits with the same arguments give different scores")


def _check_batches(subject: Subject) -> None:
    method, queries = subject.shared, Journey.draw().query_images
    _except_adapted(method)
    singles = np.concatenate([method.query(queries[i : i + 1]) for i in range(len(queries))])
    _require_same(subject.scores, singles, "a batch gives other scores than its images one by one")


def _check_order(subject: Subject) -> None:
    method = subject.shared
    _except_adapted(method)
    turned = method.query(Images.from_arrays(Journey.draw().queries[::-1]))
    _require_same(subject.scores, turned[::-1], "the order of the queries changes the scores")


def _check_scores(subject: Subject) -> None:
    world = Journey.draw()
    scores: Any = subject.shared.query(world.query_images)
    shape, kind, wanted = np.shape(scores), getattr(scores, "dtype", type(scores)), (len(world.queries), N_PLACES)
    right = isinstance(scores, np.ndarray) and (shape, kind) == (wanted, np.float32)
    require(right, f"{shape} {kind}; wanted {wanted} float32")
    _require_candidates(scores, "scores are not finite")


def _check_direction(subject: Subject) -> None:
    known = subject.shared.query(Images.from_arrays(Journey.draw().references[:N_PLACES]))
    right = np.count_nonzero(known.argmax(1) == np.arange(N_PLACES))
    require(2 * right > N_PLACES, f"only {right} of {N_PLACES} reference images score highest at their own place")


def _check_names(subject: Subject) -> None:
    world = Journey.draw()
    scores = []
    for word, order in (("place", -1), ("x", 1)):
        method = subject.make()
        names = [f"{word}-{place}" for place in world.places.tolist()]
        method.fit(Images.from_arrays(world.references, names), world.places)
        query_names = [f"{word}-{place}" for place in world.right.tolist()][::order]
        scores.append(method.query(Images.from_arrays(world.queries, query_names)))
    _require_same(scores[0], scores[1], "the names of the images change the scores")


def _check_any_image(subject: Subject) -> None:
    world = Journey.draw()
    method = subject.make()
    method.fit(Images.from_arrays([np.zeros_like(world.references[0]), *world.references[1:]]), world.places)
    larger = np.asarray(cv2.resize(world.queries[0], (96, 80)), np.uint8)
    scores = method.query(Images.from_arrays([larger, np.zeros_like(world.queries[1])]))
    _require_candidates(scores, "scores of a black image and one of another size are not finite")


def _check_stored(subject: Subject) -> None:
    if not keeps_a_network(subject.make()):
        raise RuleExceptedError("it keeps no network")
    _require_not_fitted(lambda: subject.make().state(), "state")
    world = Journey.draw()
    trained = subject.fit_new(world)
    scores = trained.query(world.query_images)
    stored = safetensors.save({name: plain(array, name) for name, array in trained.state().items()})
    require(np.array_equal(trained.query(world.query_images), scores), "storing a network changes its scores")
    for method, kind in ((subject.make(), "new"), (subject.fit_new(Journey.draw(1)), "fitted elsewhere before")):
        method.restore(safetensors.load(stored))
        same = np.array_equal(method.query(world.query_images), scores)
        require(same, f"restored into a method {kind} it gives other scores")


def _check_extended(subject: Subject) -> None:
    if not subject.make().extends:
        raise RuleExceptedError("it learns no place after fit")
    world, first_new = Journey.draw(), N_PLACES * 3 // 4
    images, is_new = world.reference_images, world.places >= first_new
    known, new = np.flatnonzero(~is_new), np.flatnonzero(is_new)
    method = subject.make()
    method.fit(images[known], world.places[known])
    scores = method.query(world.query_images)
    with _require_unchanged("the scores that match returned", scores):
        for place in range(first_new, N_PLACES):
            own = np.flatnonzero(world.places == place)
            method.extend(images[own], world.places[own])
    after = method.query(world.query_images)[:, :first_new]
    _require_same(scores, after, "learning more places changes the scores of known ones")
    right = np.count_nonzero(method.query(images[new])[:, first_new:].argmax(1) == world.places[new] - first_new)
    complaint = f"only {right} of {len(new)} images of new places score highest at their own among these"
    require(2 * right > len(new), complaint)


def _check_spikes(subject: Subject) -> None:
    world = Journey.draw()
    method = subject.fit_new(world)
    scores = method.query(world.query_images)
    codes = method.encode(world.query_images)
    with _require_unchanged("codes", codes):
        layers = list(method.spikes(codes))
    names = [layer.name for layer in layers]
    require(all(names) and len(set(names)) == len(names), f"layers named {names}; wanted a name each")
    for layer in layers:
        shape, wanted = np.shape(layer.values), f"({len(world.queries)}, n_neurons)"
        right = len(shape) == 2 and shape[0] == len(world.queries)
        require(right, f"layer {layer.name} has spikes of shape {shape}; wanted {wanted}")
        right = np.isfinite(layer.values).all() and (layer.values >= 0).all()
        require(right, f"layer {layer.name} has spikes that are not finite or below 0")
    require(np.array_equal(method.query(world.query_images), scores), "counting spikes changes later scores")


def _except_adapted(method: Method) -> None:
    """Except a method that adapts to its other queries."""
    if method.adapt in ("running", "traverse"):
        raise RuleExceptedError(f"adapt={method.adapt} takes the mean of other queries off each query")


def _as_lists(value: Any) -> Any:
    return [*map(_as_lists, value)] if isinstance(value, list | tuple) else value


@contextmanager
def _require_unchanged(name: str, *arrays: Any) -> Iterator[None]:
    """Require that the block changes none of some arrays."""
    before = [np.array(array, copy=True) for array in arrays]
    yield
    same = all(np.array_equal(np.asarray(array), copy) for array, copy in zip(arrays, before, strict=True))
    require(same, f"a call changes {name}: work on a copy, and return an array of its own")


def _require_not_fitted(call: Callable[[], Any], name: str) -> None:
    try:
        call()
    except NotFittedError:
        return
    raise RuleBrokenError(f"{name} before fit raised no NotFittedError")


def _require_candidates(scores: npt.NDArray[np.float32], complaint: str) -> None:
    """Require numbers, or -inf for a place that is no candidate, and at least one candidate a query."""
    wrong = np.count_nonzero(~np.isfinite(scores) & ~np.isneginf(scores))
    require(not wrong, f"{wrong} {complaint}")
    require(not np.isneginf(scores).all(axis=1).any(), "a query has no candidate: all its scores are -inf")


def _require_same(scores: npt.NDArray[np.float32], others: npt.NDArray[np.float32], complaint: str) -> None:
    candidate = ~np.isneginf(scores)
    require(np.array_equal(candidate, ~np.isneginf(others)), f"{complaint}: other places are candidates")
    difference = float(np.abs(scores[candidate] - others[candidate]).max(initial=0))
    scale = float(np.abs(scores[candidate]).max(initial=0))
    small = difference <= _RELATIVE * scale
    require(small, f"{complaint} (by {difference:.2g} where the largest score is {scale:.2g})")


#: The rules by the text that `check` prints, in its order.
RULES: dict[str, Callable[[Subject], None]] = {
    "the constructor only stores its arguments": _check_constructor,
    ENCODE_RULE: _check_codes,
    "fit returns the method": _check_fit,
    "fit forgets an earlier fit": _check_second_fit,
    "query before fit raises NotFittedError": _check_unfitted,
    "inputs are never modified": _check_inputs,
    "what was returned is never modified": _check_returned,
    "the same seed gives the same scores": _check_seed,
    "a batch gives what its single images give": _check_batches,
    "the order of queries does not matter": _check_order,
    "scores are finite float32 of shape (n_queries, n_places)": _check_scores,
    "higher scores mean more alike": _check_direction,
    "the names of images do not matter": _check_names,
    "black images and images of other sizes are accepted": _check_any_image,
    "a stored network answers as the trained one": _check_stored,
    "places learnt after fit are scored and change no score of known ones": _check_extended,
    "spikes are counts or amplitudes by layer and query": _check_spikes,
}
