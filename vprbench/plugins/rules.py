"""The rules of the contract, each a function that raises RuleBrokenError with what was seen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api.adaptation import Adaptation, adapt_traverse
from vprbench.api.arrays import Image, Places
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method, require_codes
from vprbench.errors import NotFittedError
from vprbench.plugins import networks
from vprbench.plugins.registry import checked

N_PLACES = 20
_RELATIVE = 1e-4  # difference in score, relative to the largest, that counts as rounding

Make = Callable[[], Method]


class RuleBrokenError(AssertionError):
    """A method or dataset broke a rule; the message says what was seen."""


class RuleExceptedError(Exception):
    """A rule does not hold for a dataset, and need not; the message says why."""


@dataclass(frozen=True)
class Journey:
    """A small made-up world: 20 places, two reference traverses, and queries of six of the places."""

    references: list[Image]
    places: Places
    queries: list[Image]
    right: npt.NDArray[np.int64]

    @classmethod
    def draw(cls, seed: int) -> Journey:
        """Draw another world for another seed."""
        generator = np.random.default_rng(seed)
        coarse = generator.integers(0, 256, (N_PLACES, 6, 8, 3), dtype=np.uint8)
        scenes = [np.asarray(cv2.resize(scene, (64, 48), interpolation=cv2.INTER_CUBIC), np.uint8) for scene in coarse]

        def seen(place: int) -> Image:
            noise = generator.integers(-12, 13, scenes[place].shape)
            return np.asarray(np.clip(scenes[place].astype(np.int64) + noise, 0, 255), np.uint8)

        right = np.array([0, 3, 7, 12, 18, 19])
        return cls(
            [seen(place) for _ in range(2) for place in range(N_PLACES)],
            np.tile(np.arange(N_PLACES), 2),
            [seen(place) for place in right.tolist()],
            right,
        )


@dataclass(frozen=True)
class Subject:
    """The method that is put to the rules: what makes a new one, and its arguments."""

    make: Make
    config: Mapping[str, Any]

    def fitted(self, world: Journey) -> Method:
        """Return a new method that has learnt a world, whatever `fit` returns."""
        method = self.make()
        method.fit(Images.from_arrays(world.references), world.places)
        return method

    @cached_property
    def fitted_once(self) -> Method:
        """A method that has learnt the first world, shared by the rules that only ask it."""
        return self.fitted(Journey.draw(0))


RULES: dict[str, Callable[[Subject], None]] = {}  # by what they say


def sentence(test: Callable[..., None]) -> str:
    """Return what a rule says: its docstring without capital and full stop."""
    said = str(test.__doc__)
    return said[0].lower() + said[1:-1]


def rule(test: Callable[[Subject], None]) -> Callable[[Subject], None]:
    """Put a function among the rules for methods, in the order of the file."""
    RULES[sentence(test)] = test
    return test


@rule
def _constructor(subject: Subject) -> None:
    """The constructor only stores its arguments."""
    method = subject.make()
    for name, value in subject.config.items():
        stored = getattr(method, name, None)
        wanted = checked(f"method.{name}", value, type(stored)) if is_dataclass(stored) else value
        if name != "_target_" and _as_lists(stored) != _as_lists(wanted):
            _broken(f"argument {name}={value} is {getattr(method, name, 'not stored')} after construction")


def _as_lists(value: Any) -> Any:
    return [*map(_as_lists, value)] if isinstance(value, list | tuple) else value


@rule
def _encodes(subject: Subject) -> None:
    """Encode returns one array whose first axis is the image."""
    world = Journey.draw(0)
    for images in world.queries, world.queries[:1]:
        require_codes(subject.fitted_once.encode(Images.from_arrays(images)), len(images))


@rule
def _returns_itself(subject: Subject) -> None:
    """Fit returns the method."""
    method, world = subject.make(), Journey.draw(0)
    returned: object = method.fit(Images.from_arrays(world.references), world.places)
    if returned is not method:
        came = "nothing" if returned is None else f"a {type(returned).__name__}"
        _broken(f"fit returned {came}: end it with return self")


@rule
def _forgets(subject: Subject) -> None:
    """Fit forgets an earlier fit."""
    first, second = Journey.draw(1), Journey.draw(2)
    method = subject.fitted(first)
    method.fit(Images.from_arrays(second.references), second.places)
    _same(
        _scores(method, second),
        _scores(subject.fitted(second), second),
        "after an earlier fit the scores differ",
    )


@rule
def _needs_fit(subject: Subject) -> None:
    """Query before fit raises NotFittedError."""
    try:
        _scores(subject.make(), Journey.draw(0))
    except NotFittedError:
        return
    _broken("no NotFittedError was raised")


@rule
def _inputs(subject: Subject) -> None:
    """Inputs are never modified."""
    world, untouched = Journey.draw(0), Journey.draw(0)
    method = subject.fitted(world)
    codes = method.encode(Images.from_arrays(world.queries))
    before = np.array(codes, copy=True)
    method.match(codes)
    if not np.array_equal(np.asarray(codes), before):
        _broken("match changed the codes")
    if not np.array_equal(world.places, untouched.places):
        _broken("fit changed the place ids")
    for seen, as_drawn in zip(world.references + world.queries, untouched.references + untouched.queries, strict=True):
        if not np.array_equal(seen, as_drawn):
            _broken("an image was changed")


@rule
def _kept_apart(subject: Subject) -> None:
    """What was returned is never modified."""
    world = Journey.draw(0)
    method = subject.fitted_once
    given = {"encode": method.encode(Images.from_arrays(world.queries[:3]))}
    before = {"encode": np.array(given["encode"], copy=True)}
    later = method.encode(Images.from_arrays(world.queries[3:]))
    given["match"] = method.match(before["encode"])
    before["match"] = np.array(given["match"], copy=True)
    method.match(later)
    for name, array in given.items():
        if not np.array_equal(np.asarray(array), before[name]):
            _broken(f"a later call changes what {name} returned: return an array of its own")


@rule
def _repeatable(subject: Subject) -> None:
    """The same seed gives the same scores."""
    world = Journey.draw(0)
    if not np.array_equal(_scores(subject.fitted_once, world), _scores(subject.fitted(world), world)):
        _broken("two fits with the same arguments give different scores")


@rule
def _batches(subject: Subject) -> None:
    """A batch gives what its single images give."""
    world = Journey.draw(0)
    method = subject.fitted_once
    adaptation = Adaptation(method)
    if not adaptation.is_causal:
        adaptation.survey(method.encode(Images.from_arrays(world.queries)))
    codes = (method.encode(Images.from_arrays([image])) for image in world.queries)
    singles = np.concatenate([method.match(adaptation.apply(code)) for code in codes])
    _same(_scores(method, world), singles, "a batch gives other scores than its images one by one")


@rule
def _order(subject: Subject) -> None:
    """The order of queries does not matter."""
    if subject.make().adapt == "running":  # the queries so far are what it adapts to
        return
    world = Journey.draw(0)
    method = subject.fitted_once
    turned = method.query(Images.from_arrays(world.queries[::-1]))
    _same(_scores(method, world), turned[::-1], "the order of the queries changes the scores")


@rule
def _shape(subject: Subject) -> None:
    """Scores are finite float32 of shape (n_queries, n_places)."""
    world = Journey.draw(0)
    scores = _scores(subject.fitted_once, world)
    wanted = (len(world.queries), N_PLACES)
    if not isinstance(scores, np.ndarray) or scores.shape != wanted or scores.dtype != np.float32:
        _broken(f"{getattr(scores, 'shape', type(scores))} {getattr(scores, 'dtype', '')}; wanted {wanted} float32")
    _only_numbers_or_no_candidates(scores, "scores are not finite")


@rule
def _higher_is_alike(subject: Subject) -> None:
    """Higher scores mean more alike."""
    world = Journey.draw(0)
    method = subject.fitted_once
    known = method.query(Images.from_arrays(world.references[:N_PLACES]))
    right = np.count_nonzero(known.argmax(1) == np.arange(N_PLACES))
    if right <= N_PLACES // 2:
        _broken(f"only {right} of {N_PLACES} reference images score highest at their own place")


@rule
def _names(subject: Subject) -> None:
    """The names of images do not matter."""
    world = Journey.draw(0)
    scores = []
    for word in ("place", "x"):
        references = Images.from_arrays(world.references, [f"{word}-{p}" for p in world.places.tolist()])
        queries = Images.from_arrays(
            world.queries, [f"{word}-{p}" for p in world.right.tolist()][:: 1 if word == "x" else -1]
        )
        method = subject.make()
        method.fit(references, world.places)
        scores.append(method.query(queries))
    _same(scores[0], scores[1], "the names of the images change the scores")


@rule
def _any_image(subject: Subject) -> None:
    """Black images and images of other sizes are accepted."""
    world = Journey.draw(0)
    black = [np.zeros_like(world.references[0]), *world.references[1:]]
    larger = [np.asarray(cv2.resize(world.queries[0], (96, 80)), np.uint8), np.zeros_like(world.queries[1])]
    method = subject.make()
    method.fit(Images.from_arrays(black), world.places)
    scores = method.query(Images.from_arrays(larger))
    _only_numbers_or_no_candidates(scores, "scores of a black image and one of another size are not finite")


@rule
def _stored(subject: Subject) -> None:
    """A stored network answers as the trained one."""
    try:
        subject.make().state()
    except NotFittedError:
        pass
    else:
        _broken("state before fit raised no NotFittedError")
    world = Journey.draw(0)
    trained = subject.fitted(world)
    answers = _scores(trained, world)
    references = Images.from_arrays(world.references)
    right = tuple(np.array([place]) for place in world.right.tolist())
    dataset = Dataset("check", references, world.places, Images.from_arrays(world.queries), right, {})
    with TemporaryDirectory() as folder:
        path = Path(folder) / "network.safetensors"
        destination = networks.prepare(networks.Files(save=path), trained, subject.config, dataset)
        assert destination is not None
        networks.save(destination, trained, "", 0.0, 0.0)
        if not np.array_equal(_scores(trained, world), answers):
            _broken("storing a network changes its scores")
        for restored, state in ((subject.make(), "new"), (subject.fitted(Journey.draw(1)), "fitted elsewhere before")):
            networks.load(path, restored, destination.origin)
            if not np.array_equal(_scores(restored, world), answers):
                _broken(f"restored into a method {state} it gives other scores")


@rule
def _extended(subject: Subject) -> None:
    """Places learnt after fit are scored and change no score of known ones."""
    world, first = Journey.draw(0), N_PLACES * 3 // 4
    images, new = Images.from_arrays(world.references), np.flatnonzero(world.places >= first)
    old = np.flatnonzero(world.places < first)
    method = subject.make()
    method.fit(images[old], world.places[old])
    before = _scores(method, world)
    kept = before.copy()
    for place in range(first, N_PLACES):
        own = np.flatnonzero(world.places == place)
        method.extend(images[own], world.places[own])
    _same(kept, _scores(method, world)[:, :first], "learning more places changes the scores of known ones")
    if not np.array_equal(before, kept):
        _broken("extend changes what match returned")
    right = np.count_nonzero(method.query(images[new])[:, first:].argmax(1) == world.places[new] - first)
    if right <= len(new) // 2:
        _broken(f"only {right} of {len(new)} images of new places score highest at their own among these")


@rule
def _spikes(subject: Subject) -> None:
    """Spikes are counts or amplitudes by layer and query."""
    world = Journey.draw(0)
    method = subject.fitted(world)
    answers = _scores(method, world)
    codes = adapt_traverse(method, method.encode(Images.from_arrays(world.queries)))
    before = np.array(codes, copy=True)
    layers = list(method.spikes(codes))
    names = [layer.name for layer in layers]
    if not all(names) or len(set(names)) < len(names):
        _broken(f"layers named {names}; wanted a name each")
    for layer in layers:
        shape = np.shape(layer.values)
        if len(shape) != 2 or shape[0] != len(world.queries):
            _broken(f"layer {layer.name} has spikes of shape {shape}; wanted ({len(world.queries)}, n_neurons)")
        if not np.isfinite(layer.values).all() or (layer.values < 0).any():
            _broken(f"layer {layer.name} has spikes that are not finite or below 0")
    if not np.array_equal(np.asarray(codes), before) or not np.array_equal(_scores(method, world), answers):
        _broken("counting spikes changes codes or later scores")


ENCODE_RULE, STORED_RULE, EXTENDED_RULE = map(sentence, (_encodes, _stored, _extended))


def _scores(method: Method, world: Journey) -> npt.NDArray[np.float32]:
    return method.query(Images.from_arrays(world.queries))


def _only_numbers_or_no_candidates(scores: npt.NDArray[np.float32], complaint: str) -> None:
    wrong = ~np.isfinite(scores) & ~np.isneginf(scores)
    if wrong.any():
        _broken(f"{np.count_nonzero(wrong)} {complaint}")
    if np.isneginf(scores).all(axis=1).any():
        _broken("a query has no candidate: all its scores are -inf")


def _same(scores: npt.NDArray[np.float32], others: npt.NDArray[np.float32], complaint: str) -> None:
    candidate = ~np.isneginf(scores)
    if not np.array_equal(candidate, ~np.isneginf(others)):
        _broken(f"{complaint}: other places are candidates")
    difference = float(np.abs(scores[candidate] - others[candidate]).max(initial=0))
    scale = float(np.abs(scores[candidate]).max(initial=0))
    if not difference <= _RELATIVE * scale:
        _broken(f"{complaint} (by {difference:.2g} where the largest score is {scale:.2g})")


def _broken(message: str) -> None:
    raise RuleBrokenError(message)
