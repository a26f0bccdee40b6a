"""DenseVLAD: dense RootSIFT at four scales, gathered by visual words, as a method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from vprbench.api import BadInput, DescriptorMethod, Image, Images, NotFittedError, Places, progress

from ..parts.vectors import k_means, unit
from .dense_sift import (
    DIMENSIONS,
    SMALLEST_SIDE,
    ArcTangent,
    compute_root_sift,
    count_descriptors,
    dense_sift,
    halve_image,
    make_grey,
)
from .vlad import PUBLISHED_WORDS, WORD_OF_ZERO, learn_whitening, read_words, vlad

_VGA = 640  # pixels
_TOGETHER = 64  # images
_SAMPLED_IMAGES = 1000  # references that the vocabulary is learnt from, at most
_SAMPLED_PER_WORD = 256  # descriptors
_WHITENED_IMAGES = 4096  # references that the whitening is learnt from, at most, unless more components want more
_IMAGES_PER_COMPONENT = 4  # with fewer, the whitening fits the references and not the places


@dataclass
class DenseVLAD(DescriptorMethod):
    """Scores a place by the product of the whitened VLADs of query and most similar reference image.

    Source: Torii et al. 2015 as in the authors' 247code, from the grey image to VLAD. Without `vocabulary` the visual
    words are learnt from the references: k-means on RootSIFT, then unit length. With it they are those of the authors'
    file dnscnt_RDSIFT_K128.mat, or of a .npy with the words alone; with `arctan`=vlfeat angles are approximated as in
    VLFeat. Both together give the authors' VLAD. The authors' projection to 4096 dimensions (an HDF5 file of 1 GB) is
    not read in this version: the whitening is always learnt from the references, by the same rule (no mean is
    subtracted). It keeps at most `n_components` and at most one for every four references; with n_components=0 there
    is none.

    Words and whitening come from what the references look like, never from their places. `encode` needs both and
    raises NotFittedError before `fit`: its code is a few thousand numbers, where the descriptors behind it would fill
    150 MB for a VGA image.
    """

    vocabulary: str | None = None
    words: int = 128
    n_components: int = 1024
    halve: bool | None = None  # keep every second pixel; None: if the longer side exceeds 640 pixels
    arctan: ArcTangent = "exact"  # vlfeat: up to 0.006 radians off
    seed: int = 0
    device: str = "cpu"

    conformance_arguments: ClassVar[Mapping[str, Any]] = {"words": 4, "n_components": 8, "halve": True}

    _words: Tensor | None = field(default=None, init=False, repr=False, compare=False)  # (words, 128)
    # (words * 128, n_components); none: no whitening
    _projection: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Learn the words and the whitening, each from a sample if there are many references, and encode all."""
        self._check_arguments()
        self._words = self.searched = self._projection = None
        generator = np.random.default_rng(self.seed)
        words = torch.from_numpy(
            self._learn_words(references, generator)
            if self.vocabulary is None
            else read_words(self.files()[0], self.words)
        ).to(self.device)
        at_most = max(_WHITENED_IMAGES, _IMAGES_PER_COMPONENT * self.n_components)
        chosen = _sample_descriptors(references, at_most if self.n_components else len(references), generator)
        vlads = self._compute_vlads(references[chosen].watched(_report_stage("describing", len(chosen))), words)
        n_components = min(self.n_components, len(chosen) // _IMAGES_PER_COMPONENT)
        self._projection = learn_whitening(vlads, max(1, n_components)) if self.n_components else None
        self._words = words
        if len(chosen) == len(references):
            return self.fit_encoded(_project_vlads(vlads, self._projection), places)
        del vlads
        return self.fit_encoded(self.encode(references.watched(_report_stage("encoding", len(references)))), places)

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the whitened VLAD of each image, (n_images, n_components), unit vectors."""
        if self._words is None:
            raise NotFittedError("DenseVLAD has no words yet: call fit(references, places) first")
        n_dimensions = DIMENSIONS * len(self._words) if self._projection is None else self._projection.shape[1]
        codes = np.empty((len(images), n_dimensions), np.float32)
        done = 0
        for block in images.blocks(_TOGETHER):
            codes[done : done + len(block)] = _project_vlads(self._compute_vlads(block, self._words), self._projection)
            done += len(block)
        return codes

    def files(self) -> Sequence[Path]:
        """Return the file of the vocabulary if one was given; raises BadInput if it is missing."""
        if self.vocabulary is None:
            return ()
        path = Path(self.vocabulary).expanduser()
        if not path.is_file():
            raise BadInput(f"method.vocabulary={self.vocabulary} is no file: leave it out for words of the references")
        return (path,)

    def _check_arguments(self) -> None:
        """Raise BadInput for arguments under which there is no descriptor."""
        if self.words < 1:
            raise BadInput(f"method.words={self.words}: give at least 1 visual word")
        if self.n_components < 0:
            raise BadInput(f"method.n_components={self.n_components}: give 0 for no whitening, or more")

    def _learn_words(self, references: Images, generator: np.random.Generator) -> npt.NDArray[np.float32]:
        """Return unit vectors, (words, 128): k-means on descriptors of enough contrast, drawn from all scales."""
        chosen = _sample_descriptors(references, _SAMPLED_IMAGES, generator)
        per_image = _SAMPLED_PER_WORD * self.words / len(chosen)
        drawn = [np.empty((0, DIMENSIONS), np.float32)]
        for image in references[chosen].watched(_report_stage("sampling", len(chosen))):
            grey = self._make_grey(image)
            share = per_image / count_descriptors(*grey.shape)
            for block in dense_sift(grey, self.arctan):
                picked = block[torch.from_numpy(generator.random(len(block)) < share).to(self.device)]
                drawn.append(compute_root_sift(picked[picked.any(1)]).cpu().numpy())
        return unit(k_means(np.concatenate(drawn), self.words, generator))

    def _compute_vlads(self, images: Images, words: Tensor) -> npt.NDArray[np.float32]:
        """Return the VLAD of each image before whitening, (n_images, words * 128)."""
        vectors = np.empty((len(images), words.numel()), np.float32)
        published = self.vocabulary is not None and len(words) == PUBLISHED_WORDS
        for number, image in enumerate(images):
            blocks = (compute_root_sift(block) for block in dense_sift(self._make_grey(image), self.arctan))
            vectors[number] = vlad(blocks, words, WORD_OF_ZERO if published else 0).cpu().numpy()
        return vectors

    def _make_grey(self, image: Image) -> Tensor:
        """Return the grey image, halved if asked for, 0 to 1; raises BadInput for one that is too small."""
        grey = make_grey(image)
        halve = max(grey.shape) > _VGA if self.halve is None else self.halve
        if halve:
            grey = halve_image(grey)
        height, width = grey.shape
        if min(height, width) < SMALLEST_SIDE:
            raise BadInput(
                f"an image of {width}x{height} pixels{' after halving' if halve else ''}: DenseVLAD needs at least "
                f"{SMALLEST_SIDE}x{SMALLEST_SIDE}; " + ("set method.halve=false" if halve else "give larger images")
            )
        return torch.from_numpy(grey).to(self.device, torch.float32) / 255


def _project_vlads(
    vlads: npt.NDArray[np.float32], projection: npt.NDArray[np.float32] | None
) -> npt.NDArray[np.float32]:
    """Return the whitened vectors at unit length, or the vectors themselves if there is no projection."""
    return vlads if projection is None else unit(vlads @ projection)


def _sample_descriptors(images: Images, at_most: int, generator: np.random.Generator) -> npt.NDArray[np.int64]:
    """Draw images without repeating one, in their order; all of them if there are no more."""
    n = len(images)
    return np.arange(n) if n <= at_most else np.sort(generator.choice(n, at_most, replace=False))


def _report_stage(stage: str, total: int) -> Callable[[int], None]:
    """Return a function that reports how many of a stage's images are done."""
    return lambda done: progress.report(stage, done / total)
