"""What all descriptors from a published network share: its file, its batches, its device and its precision."""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import cv2
import numpy as np
import numpy.typing as npt
import torch
from PIL import Image as PillowImage
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api.arrays import Image
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.weights import Weights, find_weights
from vprbench.errors import BadInput

Resize = Literal["pillow", "tensor", "opencv", "area"]
Interpolation = Literal["bilinear", "bicubic"]
Preprocessing = Literal["authors", "vpr_methods_evaluation"]

_PILLOW = {"bilinear": PillowImage.Resampling.BILINEAR, "bicubic": PillowImage.Resampling.BICUBIC}
_OPENCV = {"bilinear": cv2.INTER_LINEAR, "bicubic": cv2.INTER_CUBIC}


def resize_image(
    image: Image, height: int, width: int, how: Literal["pillow", "opencv", "area"], kind: Interpolation
) -> npt.NDArray[Any]:
    """Resize a decoded image, uint8 (h, w, 3), to (height, width, 3).

    pillow: antialiased, as torchvision resizes a Pillow image, whole levels; opencv: not antialiased, whole levels;
    area: means over areas, or bilinear if a side grows, as float32 levels that are not rounded
    (cvg/Hierarchical-Localization c13273b); it has no other `kind`.
    """
    if image.shape[:2] == (height, width):
        return image
    if how == "area":
        grows = height > image.shape[0] or width > image.shape[1]
        way = cv2.INTER_LINEAR if grows else cv2.INTER_AREA
        return cv2.resize(image.astype(np.float32), (width, height), interpolation=way)
    if how == "opencv":
        return np.asarray(cv2.resize(image, (width, height), interpolation=_OPENCV[kind]), np.uint8)
    return np.asarray(PillowImage.fromarray(image).resize((width, height), _PILLOW[kind]))


def resize_batch(batch: Tensor, height: int, width: int, kind: Interpolation) -> Tensor:
    """Resize float images (n, channels, h, w) to (n, channels, height, width), antialiased, as torchvision does."""
    if batch.shape[-2:] == (height, width):
        return batch
    return functional.interpolate(batch, (height, width), mode=kind, align_corners=False, antialias=True)


def centre_crop(batch: Tensor, multiple: int) -> Tensor:
    """Return the middle of images (n, channels, h, w) whose sides are multiples, as torchvision's CenterCrop."""
    height, width = batch.shape[-2:]
    rows, columns = (side // multiple * multiple for side in (height, width))
    top, left = round((height - rows) / 2), round((width - columns) / 2)  # halves go to the even number
    return batch[..., top : top + rows, left : left + columns]


Precision = Literal["float32", "float16", "bfloat16"]

IMAGENET_MEAN = (0.485, 0.456, 0.406)  # of RGB, 0 to 1
IMAGENET_DEVIATION = (0.229, 0.224, 0.225)

_BATCH_BYTES = 1 << 28  # of images in a batch, as float32
_ANY_SIDE = 224  # pixels


@dataclass(kw_only=True, eq=False)
class NeuralDescriptor(DescriptorMethod):
    """A method whose descriptor is the output of a published network; `load` and `blank` are left to write.

    The constructor reads nothing: the network is loaded, and its file fetched if that is possible, when it is first
    needed. Images of one size go through it together, up to `batch_size`. On a GPU the next batch is read and resized
    meanwhile. Descriptors are float32 of unit length whatever the precision of the network; float32 is exact (no TF32).

    `preprocessing`=authors resizes as `resize` and `interpolation` say, whose defaults are those of the authors' own
    evaluation. vpr_methods_evaluation resizes as gmberton/VPR-methods-evaluation does it for every network, whatever
    those two say: `height` and `width` are its image size, and without them images keep their size, or get the nearest
    multiples that the network takes.
    """

    weights: Weights
    height: int | None = None  # pixels that images are resized to; None: as they are
    width: int | None = None
    preprocessing: Preprocessing = "authors"
    # pillow: antialiased image; tensor: antialiased floats; area: means over areas; opencv: not antialiased
    resize: Resize = "pillow"
    interpolation: Interpolation = "bilinear"
    batch_size: int = 16
    precision: Precision = "float32"
    device: str = "cpu"

    query_arguments: ClassVar[frozenset[str]] = DescriptorMethod.query_arguments | {"batch_size", "device"}
    #: Pixels that height and width have to be multiples of.
    multiple: ClassVar[int] = 1
    #: Pixels of the shorter side under which the network has no output.
    smallest_side: ClassVar[int] = 1
    #: Whether the authors cut images to such multiples, from the middle, rather than resize them.
    crops: ClassVar[bool] = False
    #: Whether the network takes images of one size only.
    fixed_size: ClassVar[bool] = False

    _network: nn.Module | None = field(default=None, init=False, repr=False, compare=False)

    @abstractmethod
    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file, strictly; raises BadInput for any other file.

        The network takes what `pixels` gives and returns (n_images, n_dimensions).
        """

    @abstractmethod
    def blank(self) -> nn.Module:
        """Return the network in its published sizes, without their values: what it costs does not depend on them."""

    def files(self) -> Sequence[Path]:
        """Return the file of weights, fetched if that is possible; raises BadInput if it is missing.

        Arguments that do not fit are told first: a download may take long.
        """
        self._check_arguments()
        return (find_weights(self.weights, type(self).__name__),)

    def keeps_descriptors(self) -> bool:
        """Tell that descriptors are worth keeping on disk."""
        return True

    def use(self, network: nn.Module) -> None:
        """Describe images with this network from now on."""
        network = network.to(self.device, self._number_type)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # which PyTorch's hints forgot
        self._network = network.eval().requires_grad_(False)

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return unit vectors, (n_images, n_dimensions); a zero vector if the network gives zeros alone."""
        self._check_arguments()
        if not len(images):
            side = max(_ANY_SIDE, self.smallest_side)
            black = np.zeros((self.height or side, self.width or side, 3), np.uint8)
            return self.encode(Images.from_arrays([black]))[:0]
        if self._network is None:
            self.use(self.load(self.files()[0]))
        codes: npt.NDArray[np.float32] | None = None
        done = 0
        # Closed at once, whatever fails: otherwise its threads would live as long as somebody holds the error.
        with (
            torch.inference_mode(),
            _forbid_tf32(),
            contextlib.closing(self._read_batches(images)) as batches,
        ):
            for batch in batches:
                vectors = functional.normalize(self._described(batch).float(), dim=1).cpu().numpy()
                if not np.isfinite(vectors).all():
                    raise BadInput(
                        f"{type(self).__name__} gives numbers that are not finite in {self.precision}: "
                        + ("give other weights" if self.precision == "float32" else "set method.precision=float32")
                    )
                if codes is None:
                    codes = np.empty((len(images), vectors.shape[1]), np.float32)
                codes[done : done + len(vectors)] = vectors
                done += len(vectors)
        return cast(npt.NDArray[np.float32], codes)

    def target(self, height: int, width: int) -> tuple[int, int]:
        """Return the height and width that an image of `height` x `width` pixels is resized to."""
        wanted = (self.height or height, self.width or width)
        return cast(tuple[int, int], tuple(max(1, round(side / self.multiple)) * self.multiple for side in wanted))

    def pixels(self, levels: Tensor) -> Tensor:
        """Return what the network sees of RGB levels 0..255, (n, 3, height, width): ImageNet's normalisation."""
        mean, deviation = (levels.new_tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_DEVIATION))
        return (levels / 255 - mean) / deviation

    @property
    def _number_type(self) -> torch.dtype:
        return cast(torch.dtype, getattr(torch, self.precision))

    @property
    def _resizing(self) -> tuple[Resize, Interpolation]:
        """How images are resized; gmberton/VPR-methods-evaluation adbb6e2 resizes tensors after their normalisation."""
        return (self.resize, self.interpolation) if self.preprocessing == "authors" else ("tensor", "bilinear")

    def _described(self, batch: npt.NDArray[Any]) -> Tensor:
        """Return the output for images of one size, (n, height, width, 3)."""
        network = cast(nn.Module, self._network)
        levels = torch.from_numpy(batch)
        if self.device != "cpu":
            levels = levels.pin_memory().to(self.device, non_blocking=True)
        # Channels come last in the array already, which convolutions like best.
        seen = self.pixels(levels.permute(0, 3, 1, 2).float())
        how, kind = self._resizing
        if how == "tensor":
            seen = resize_batch(seen, *self.target(*batch.shape[1:3]), kind)
        if self.crops and self.preprocessing == "authors":
            seen = centre_crop(seen, self.multiple)
        return cast(Tensor, network(seen.to(self._number_type)))

    def _read_batches(self, images: Images) -> Generator[npt.NDArray[Any]]:
        """Yield the images in order, in batches of one size, the next one made while the last is looked at."""
        batches = self._gather_batches(images)
        if self.device == "cpu":  # another thread would take the cores from the network
            yield from batches
            return
        with ThreadPoolExecutor(1) as ahead:
            coming = ahead.submit(next, batches, None)
            while (batch := coming.result()) is not None:
                coming = ahead.submit(next, batches, None)
                yield batch

    def _gather_batches(self, images: Images) -> Iterator[npt.NDArray[Any]]:
        batch: list[npt.NDArray[Any]] = []
        for image in map(self._resize_image, images):
            if batch and (image.shape != batch[0].shape or len(batch) == self._at_most(batch[0])):
                yield np.stack(batch)
                batch = []
            batch.append(image)
        yield np.stack(batch)

    def _at_most(self, image: npt.NDArray[Any]) -> int:
        """Return how many such images go through the network together."""
        n_pixels = max(image.size // 3, math.prod(self.target(*image.shape[:2])))  # a tensor may become larger
        return min(self.batch_size, max(1, _BATCH_BYTES // (12 * n_pixels)))

    def _resize_image(self, image: Image) -> npt.NDArray[Any]:
        """Resize an image if that comes before its levels become floats; raises BadInput for one too small."""
        height, width = self.target(*image.shape[:2])
        if min(height, width) < self.smallest_side:
            raise BadInput(
                f"an image of {image.shape[1]}x{image.shape[0]} pixels, seen as {width}x{height}: "
                f"{type(self).__name__} needs {self.smallest_side} pixels a side; set method.height and method.width"
            )
        how, kind = self._resizing
        return image if how == "tensor" else resize_image(image, height, width, how, kind)

    def _check_arguments(self) -> None:
        """Raise BadInput for arguments that do not fit."""
        if self.batch_size < 1:
            raise BadInput(f"method.batch_size={self.batch_size}: give at least 1 image")
        for name in ("height", "width"):
            side = getattr(self, name)
            if side is not None and (side < 1 or side % self.multiple):
                raise BadInput(f"method.{name}={side}: give a multiple of {self.multiple}, or null for the image's own")
        if self._number_type != torch.float32 and self.device == "cpu":
            raise BadInput(f"method.precision={self.precision}: on the CPU float32 alone is offered; set device=cuda")


@contextlib.contextmanager
def _forbid_tf32() -> Iterator[None]:
    """Keep TF32 out of float32 convolutions on a GPU: it changes descriptors by thousandths."""
    kept = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = kept
