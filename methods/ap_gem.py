"""AP-GeM: a ResNet trained for average precision, pooled by generalised mean and whitened, as a method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, read_weights, state_dict

from .parts.backbones.convolutional import GeM, build_resnet, count_channels
from .parts.published import PublishedNetwork, Tensors, read_size

_BACKBONE = "resnet101"
_N_DIMENSIONS = 2048
_LANDMARKS = "Landmarks_clean"  # the photographs that the whitening was learnt from
_POWER = 0.25  # of the variances that the whitening divides by


class _PCA:
    """A stand-in for scikit-learn's PCA: a file fills its arrays, and no code of the file runs."""

    mean_: Any = None
    components_: Any = None
    explained_variance_: Any = None


@dataclass(kw_only=True)
class APGeM(PublishedNetwork):
    """Scores a place by the cosine between the whitened GeM of query and most similar reference image: 2048 numbers.

    ResNet101's features are pooled with a learnt power, projected, made unit vectors and whitened by a PCA of landmark
    photographs, each component divided by its variance to the power of 0.25. Images keep their size, and are seen at
    one scale, unless `height` and `width` are given, as the authors evaluate.
    Source: Revaud et al. 2019 and naver/deep-image-retrieval.
    """

    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file, whose PCA is read without running its code.

        Raises BadInput for any other file.
        """
        with torch.serialization.safe_globals(
            [(_PCA, f"sklearn.decomposition.{name}.PCA") for name in ("pca", "_pca")]
        ):
            content = read_weights(path)
            tensors = state_dict(path, "state_dict")
        network = cast(_APGeM, self.loaded({**tensors, **_read_whitening(content, path)}, path))
        options = content.get("model_options")
        network.unit_features = isinstance(options, Mapping) and bool(options.get("norm_features"))
        return network

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 2048 dimensions, or as many as a file has."""
        return _APGeM(read_size(tensors, "fc.bias", 0, _N_DIMENSIONS))

    def name_parts(self, network: nn.Module) -> nn.Module:
        """Return the parts of the backbone beside the others, as the file has them."""
        parts = dict(network.named_children())
        return nn.ModuleDict(dict(parts.pop("backbone").named_children()) | parts)


class _APGeM(nn.Module):
    """Images (n, 3, height, width) to descriptors (n, n_dimensions), float32, not yet of unit length."""

    def __init__(self, n_dimensions: int) -> None:
        super().__init__()
        self.backbone = build_resnet(_BACKBONE, names="words")
        self.adpool = GeM()
        self.fc = nn.Linear(count_channels(_BACKBONE), n_dimensions)
        self.unit_features = False  # whether what was pooled gets unit length
        self.whitening = nn.ParameterDict(
            {"mean": torch.zeros(n_dimensions), "components": torch.zeros(n_dimensions, n_dimensions)}
        )

    def forward(self, images: Tensor) -> Tensor:
        pooled = self.adpool(self.backbone(images))
        if self.unit_features:
            pooled = functional.normalize(pooled, dim=1)
        vectors = functional.normalize(self.fc(pooled.to(images.dtype)).float(), dim=1)
        return cast(Tensor, (vectors - self.whitening["mean"].float()) @ self.whitening["components"].float().T)


def _read_whitening(content: Mapping[str, Any], path: Path) -> dict[str, Tensor]:
    """Return the tensors of the whitening that a file holds; raises BadInput if it holds no whole one."""
    found = content.get("pca")
    pca = found.get(_LANDMARKS) if isinstance(found, Mapping) else None
    arrays = [getattr(pca, name, None) for name in ("mean_", "components_", "explained_variance_")]
    if not all(isinstance(array, np.ndarray) and array.dtype.kind == "f" for array in arrays):
        raise BadInput(f"{path} holds no pca of {_LANDMARKS}: give the authors' file as it was unpacked")
    mean, components, variances = (torch.from_numpy(np.array(array, np.float64)) for array in arrays)
    return {"whitening.mean": mean, "whitening.components": components / variances[:, None] ** _POWER}
