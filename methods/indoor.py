"""EigenPlaces and SALAD trained further indoors: the same networks, one module deeper in their files, as methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import torch
from torch import Tensor, nn

from vprbench.api import BadInput, Resize, load_strictly, state_dict

from .cosplace import Backbone, EigenPlaces
from .salad import SALAD, loaded

_WRAPPER = "model"


@dataclass(kw_only=True)
class EigenPlacesIndoor(EigenPlaces):
    """EigenPlaces' ResNet50 of 2048 dimensions, trained further indoors: Enrico-Chiavassa/Indoor-VPR f7bbc18."""

    published: ClassVar[Mapping[Backbone, Sequence[int]]] = MappingProxyType({"ResNet50": (2048,)})

    def load(self, path: Path) -> nn.Module:
        """Return the network; raises BadInput for a file of another backbone, of other dimensions or not wrapped."""
        with torch.device("meta"):
            network = self.blank()
        load_strictly(nn.ModuleDict({_WRAPPER: network}), state_dict(path), path)
        return network


@dataclass(kw_only=True)
class SALADIndoor(SALAD):
    """SALAD trained further indoors, which sees images in their own size: Enrico-Chiavassa/Indoor-VPR f7bbc18.

    Both sides become the nearest multiples of 14, antialiased on floats, as the published network resizes by itself.
    """

    height: int | None = None
    width: int | None = None
    resize: Resize = "tensor"

    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file; raises BadInput for any other file."""
        return loaded(_unwrapped(state_dict(path), path), path)


def _unwrapped(tensors: Mapping[str, Tensor], path: Path) -> dict[str, Tensor]:
    """Return tensors under their names within the wrapper; raises BadInput where one lies outside it."""
    outside = next((name for name in tensors if not name.startswith(f"{_WRAPPER}.")), None)
    if outside is not None:
        raise BadInput(f"{path} holds {outside}, wanted names in {_WRAPPER}.: give the weights of Indoor-VPR")
    return {name.removeprefix(f"{_WRAPPER}."): tensor for name, tensor in tensors.items()}
