"""EigenPlaces and SALAD trained further indoors: the same networks, under names that begin with `model.`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from vprbench.api import Resize

from .cosplace import Backbone, EigenPlaces
from .salad import SALAD


@dataclass(kw_only=True)
class EigenPlacesIndoor(EigenPlaces):
    """EigenPlaces' ResNet50 of 2048 dimensions, trained further indoors: Enrico-Chiavassa/Indoor-VPR f7bbc18."""

    published: ClassVar[Mapping[Backbone, Sequence[int]]] = MappingProxyType({"ResNet50": (2048,)})


@dataclass(kw_only=True)
class SALADIndoor(SALAD):
    """SALAD trained further indoors, which sees images in their own size: Enrico-Chiavassa/Indoor-VPR f7bbc18.

    Both sides become the nearest multiples of 14, antialiased on floats, as the published network resizes by itself.
    """

    height: int | None = None
    width: int | None = None
    resize: Resize = "tensor"
