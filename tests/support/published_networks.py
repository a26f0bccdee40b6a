"""Checks that every published network has to pass, put to it as scikit-learn puts its own to estimators."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from described_images import composed, distance, encoded, image
from torch import Tensor

from vprbench.api.arrays import Image
from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.plugins import conformance, registry

Tensors = Mapping[str, Tensor]


def saved(path, tensors):
    """Write tensors as torch does; returns the file."""
    torch.save(dict(tensors), path)
    return path


def saved_training(path, tensors, key="model_state_dict"):
    """Write a checkpoint of a training, which keeps its optimizer, and recalls as numpy has them."""
    optimizer = {"state": {}, "param_groups": [{"lr": 0.1, "params": [0, 1]}]}
    recalls = {"recalls": np.ones(4), "best_r5": np.float64(97.5)}
    return saved(path, {key: dict(tensors), "epoch": 30, "optimizer": optimizer, "parallel": False, **recalls})


def unit(vectors):
    """Return vectors, along the last axis, at unit length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@dataclass(frozen=True, eq=False)
class PublishedNetwork:
    """A network in small sizes: how its file is written in the published layout, and what has to come out of it."""

    name: str  # of the yaml
    draw: Callable[[], Tensors]  # random values under the published names
    images: Sequence[Image]
    n_dimensions: int
    #: The descriptor in float64 of tensors and one image, of any length; keyword arguments are those of `options`.
    expected: Callable[..., Any]
    write: Callable[[Path, Tensors], Path] = saved
    arguments: Mapping[str, Any] = field(default_factory=dict)
    #: Arguments that are further files, and what writes each beside the file of weights.
    beside: Mapping[str, Callable[[Path], Path]] = field(default_factory=dict)
    tolerance: float = 1e-5
    #: By name: arguments, image and the keyword arguments under which `expected` gives its descriptor.
    options: Mapping[str, tuple[Mapping[str, Any], Image, Mapping[str, Any]]] = field(default_factory=dict)
    #: What the refusal names, the arguments and the size of the image that are refused.
    refused: Sequence[tuple[str, Mapping[str, Any], tuple[int, int]]] = ()

    @cached_property
    def tensors(self):
        """The random values, drawn once."""
        return self.draw()

    def file(self, folder):
        """Return the file, written where it is missing."""
        path = folder / f"{self.name}.weights"
        return path if path.exists() else self.write(path, self.tensors)

    def method(self, path, **arguments):
        """Return the method with these weights; what the yaml says of the size of images is left out."""
        kind, files = registry.find_entries("method")[self.name].target(), self.files(path)
        given = {name: Weights(file.name, "none", "nothing", path=str(file)) for name, file in files.items()}
        return kind(**{**given, **self.arguments, **arguments})

    def files(self, path):
        return {"weights": path} | {name: write(path) for name, write in self.beside.items()}

    def encode(self, folder, *images, **arguments):
        return encoded(self.method(self.file(folder), **arguments), *images)

    @cache  # noqa: B019 - networks live as long as the tests
    def codes(self, folder):
        """Return the descriptors of the images, computed once."""
        return self.encode(folder, *self.images)

    def slowly(self, *images, tensors=None, **how):
        """Return the descriptors of the slow computation at unit length, each image alone."""
        own = self.tensors if tensors is None else tensors
        return np.stack([unit(np.asarray(self.expected(own, seen, **how))) for seen in images])

    def check_contract(self, folder, **options):
        """Put the method to every rule; returns the rules that it is excepted from. The network is read once."""
        config = composed(f"method={self.name}") | dict(self.arguments) | options
        path = self.file(folder)
        for name, file in self.files(path).items():
            config[name]["path"] = str(file)
        return excepted(config, registry.make_method(config).load(path))

    def checks(self):
        """Yield each check's name and what runs it, given a folder that files may be written to."""
        yield "descriptors", self._has_the_descriptors_of_the_slow_computation
        yield "half precision", self._half_the_precision_keeps_the_descriptor
        for name, option in self.options.items():
            yield f"option {name}", partial(self._has_the_descriptors_under, *option)
        for told, arguments, size in self.refused:
            yield f"refused {told} {arguments}", partial(self._refuses, told, arguments, size)

    def _has_the_descriptors_of_the_slow_computation(self, folder):
        codes = self.codes(folder)
        assert codes.shape == (len(self.images), self.n_dimensions)
        assert codes.dtype == np.float32
        assert np.abs(np.linalg.norm(codes.astype(np.float64), axis=1) - 1).max() < 1e-6
        assert distance(codes, self.slowly(*self.images)) < self.tolerance
        assert distance(codes[0], codes[1]) > 1e-3
        alone = encoded(self.method(self.file(folder)), self.images[-1])
        assert distance(alone, codes[-1:]) < 1e-5

    def _half_the_precision_keeps_the_descriptor(self, folder):
        method = self.method(self.file(folder))
        network = method.load(self.file(folder))
        method.use(network)
        seen = method.pixels(torch.from_numpy(image(*method.target(56, 98))).permute(2, 0, 1)[None].float())
        with torch.inference_mode():
            exact = network(seen)
            self.method(self.file(folder), precision="bfloat16").use(network)
            half = network(seen.to(torch.bfloat16)).float()
        assert torch.nn.functional.cosine_similarity(half, exact).min() > 0.9

    def _has_the_descriptors_under(self, arguments, seen, how, folder):
        assert distance(self.encode(folder, seen, **arguments), self.slowly(seen, **how)) < self.tolerance

    def _refuses(self, told, arguments, size, folder):
        with pytest.raises(BadInput, match=re.escape(told)) as error:
            self.encode(folder, image(*size), **arguments)
        assert "\n" not in str(error.value)


def excepted(config, network):
    """Put the method of a configuration, with a network in its file's place, to every rule; returns the exceptions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(registry.make_method(config)), "load", lambda *_: network)
        usual = ("it keeps no network", "it learns no place after fit")
        results = [result for result in conformance.check_method(config) if result.reason not in usual]
    assert [str(result) for result in results if result.state == "broken"] == []
    return {result.rule for result in results if result.state == "excepted"}


def with_checks(*networks):
    """Parametrise a test by every check of the networks; it calls `check(folder)`."""
    cases = [
        pytest.param(check, id=f"{network.name} {name}") for network in networks for name, check in network.checks()
    ]
    return pytest.mark.parametrize("check", cases)
