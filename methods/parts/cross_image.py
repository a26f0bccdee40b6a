"""Descriptors that look at several images together: how many these are, and the encoder that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy.typing as npt
import torch
from torch import Tensor, nn

from vprbench.api import BadInput

from .published import PublishedNetwork, Tensors, read_size

_HEADS, _LAYERS = 16, 2
_REASON = "images that are described together see one another; images_together=1 describes each alone"


@dataclass(kw_only=True)
class CrossImageDescriptor(PublishedNetwork):
    """A descriptor of an image that may look at its neighbours too; `network` is left to write.

    `images_together` consecutive images of one call of `encode` attend to one another, the last ones to as many as are
    left. With 1 each image is described alone, and no answer depends on other queries. The authors evaluate with
    16, which helps if neighbours show one place: a query then has the help of other queries. A batch holds whole
    groups, even if they are more than `batch_size`. With `resize=tensor` only images of one size go together.
    """

    images_together: int = 1

    @property
    def conformance_exceptions(self) -> Mapping[str, str]:  # type: ignore[override]  # 1 image has none
        """The rule of the conformance suite that images of one group cannot keep, and the reason."""
        return {} if self.images_together == 1 else {"a batch gives what its single images give": _REASON}

    @property
    def extends(self) -> bool:
        """Whether new places are appended: not if the images of a map saw one another."""
        return self.images_together == 1 and super().extends

    def notes(self) -> Sequence[str]:
        """Return that queries had the help of other queries, if they had."""
        if self.images_together == 1:
            return ()
        return (
            f"{self.images_together} consecutive images were described together: each query had the help of the "
            "queries beside it",
        )

    def keeps_descriptors(self) -> bool:
        """Tell that descriptors are worth keeping if they do not depend on the images that are encoded with them."""
        return self.images_together == 1

    def _at_most(self, image: npt.NDArray[Any]) -> int:
        together = self.images_together
        return max(together, super()._at_most(image) // together * together)

    def _check_arguments(self) -> None:
        super()._check_arguments()
        if self.images_together < 1:
            raise BadInput(f"method.images_together={self.images_together}: give at least 1 image")


class CrossImageEncoder(nn.Module):
    """Two transformer layers in which each part of an image attends to the same part of the images of its group.

    Parts are (n, n_parts, dim), in groups of `together` consecutive images. The layers have 16 heads, normalise after
    each addition, and bear the names of `torch.nn.TransformerEncoder`.
    """

    def __init__(self, dim: int, n_hidden: int, together: int) -> None:
        super().__init__()
        self.together = together
        layers = (nn.TransformerEncoderLayer(dim, _HEADS, n_hidden, 0.0, "gelu") for _ in range(_LAYERS))
        self.layers = nn.Sequential(*layers)
        self.eval()

    @classmethod
    def sized(cls, tensors: Tensors, dim: int, together: int) -> Self:
        """Build the encoder of a file's tensors, or the published one, for groups of `together` images."""
        return cls(dim, read_size(tensors, "encoder.layers.0.linear1.weight", 0, 2048), together)

    def forward(self, parts: Tensor) -> Tensor:
        """Return the parts as their group changes them, (n, n_parts, dim)."""
        return torch.cat([self.layers(group) for group in torch.split(parts, self.together)])
