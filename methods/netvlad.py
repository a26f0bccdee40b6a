"""NetVLAD: the local descriptors of VGG16 in soft clusters, of three families of published weights, and SFRS."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, read_mat

from .parts.backbones.convolutional import VGG16_CHANNELS, build_vgg16
from .parts.published import PublishedNetwork, Tensors, read_size

Family = Literal["matconvnet", "pytorch", "patch-netvlad"]

STRIDE = 16  # pixels between local descriptors

_VGG16_LAYERS = 29  # up to conv5_3
_USUAL_MEAN = (123.68, 116.78, 103.94)  # RGB levels; each file of MatConvNet brings its own

_SFRS_MEAN = (123.68, 116.779, 103.939)  # RGB levels

_MATCONVNET_LAYERS = 35
_MATCONVNET_VLAD, _MATCONVNET_WHITENING = 30, 33  # the layers before them are VGG16's, numbered alike


@dataclass(kw_only=True)
class NetVLAD(PublishedNetwork):
    """Scores a place by the cosine between the whitened VLADs of query and most similar reference image.

    `family` is the layout of the file: matconvnet, the authors' networks as structs in a .mat; pytorch, those of
    Nanne/pytorch-NetVlad, without whitening; patch-netvlad, those of QVPR/Patch-NetVLAD. They differ in what the
    network sees (levels less the mean of the file; ImageNet's normalisation for the others) and in the order of the
    VLAD before whitening (cluster fastest; channel fastest for the others). Images keep their size, but for `height`
    and `width`, and those with more than `longest_side` pixels then shrink to it, unless `preprocessing` is
    vpr_methods_evaluation. With `n_dimensions` the first values alone are kept, and made a unit vector again.
    Source: Arandjelovic et al. 2016, Relja/netvlad 652dbe7 as cvg/Hierarchical-Localization c13273b runs it,
    Nanne/pytorch-NetVlad def998e and QVPR/Patch-NetVLAD 39ab4e4.
    """

    family: Family = "matconvnet"
    whiten: bool = True
    n_dimensions: int | None = None
    longest_side: int | None = None  # pixels

    smallest_side: ClassVar[int] = STRIDE

    def target(self, height: int, width: int) -> tuple[int, int]:
        """Return the height and width that an image is resized to."""
        wanted = super().target(height, width)
        if self.longest_side is None or max(wanted) <= self.longest_side or self.preprocessing != "authors":
            return wanted
        shrunk = (max(1, round(side * self.longest_side / max(wanted))) for side in wanted)
        return cast(tuple[int, int], tuple(shrunk))

    def pixels(self, levels: Tensor) -> Tensor:
        """Return what the network sees of RGB levels 0..255: less the mean of the file, or ImageNet's normalisation."""
        mean = cast(Network, self._network).mean
        return super().pixels(levels) if mean is None else levels - levels.new_tensor(mean)[:, None, None]

    def load(self, path: Path) -> nn.Module:
        """Return the network; raises BadInput for a file of another family."""
        if self.family != "matconvnet":
            return super().load(path)
        tensors, mean = read_struct(path)
        network = cast(Network, self.loaded(tensors, path))
        network.mean = mean
        return network

    def loaded(self, tensors: Tensors, path: Path) -> nn.Module:
        """Return the network with tensors of `path`, without the whitening if none is wanted."""
        if not self.whiten and self.family != "pytorch":
            tensors = {name: tensor for name, tensor in tensors.items() if not name.startswith("WPCA.")}
        return super().loaded(tensors, path)

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network in the sizes of a file; raises BadInput for more dimensions than it has."""
        clusters, components = read_sizes(tensors, self.weights.file)
        n_values = components if self.whiten else clusters * VGG16_CHANNELS
        if tensors and self.n_dimensions is not None and self.n_dimensions > n_values:
            raise BadInput(f"method.n_dimensions={self.n_dimensions}: the file gives {n_values}, ask for no more")
        matconvnet = self.family == "matconvnet"
        return Network(
            clusters,
            components if self.whiten else None,
            mean=_USUAL_MEAN if matconvnet else None,
            cluster_fastest=matconvnet,
            n_dimensions=self.n_dimensions,
        )

    def _check_arguments(self) -> None:
        super()._check_arguments()
        if self.family == "pytorch" and self.whiten:
            raise BadInput("method.whiten=true: files of method.family=pytorch hold no whitening; set whiten=false")
        for name in ("n_dimensions", "longest_side"):
            if (value := getattr(self, name)) is not None and value < 1:
                raise BadInput(f"method.{name}={value}: give at least 1, or null for all")


@dataclass(kw_only=True)
class SFRS(PublishedNetwork):
    """Scores a place by the cosine between the whitened VLADs of query and most similar reference image.

    VGG16 in 64 clusters, whitened to 4096 dimensions, channels fastest; it sees levels less their mean. The authors
    evaluate at 640x480 (on Tokyo 24/7 with a shorter side of 640).
    Source: Ge et al. 2020 and yxgeee/OpenIBL dea9d41.
    """

    height: int | None = 480
    width: int | None = 640

    smallest_side: ClassVar[int] = STRIDE

    def pixels(self, levels: Tensor) -> Tensor:
        """Return RGB levels 0..255 less their mean."""
        return levels - levels.new_tensor(_SFRS_MEAN)[:, None, None]

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 64 clusters and 4096 dimensions, or in the sizes of a file."""
        return Network(read_size(tensors, "net_vlad.centroids", 0, 64), read_size(tensors, "pca_layer.weight", 0, 4096))

    def name_parts(self, network: nn.Module) -> nn.Module:
        """Return the parts of the network under their names in the file."""
        own = cast(Network, network)
        base = nn.ModuleDict({"base": own.encoder})
        return nn.ModuleDict({"base_model": base, "net_vlad": own.pool, "pca_layer": cast(nn.Sequential, own.WPCA)[0]})


class Clusters(nn.Module):
    """Soft clusters of unit vectors: assigned by a convolution without bias, gathered as residuals to centroids."""

    def __init__(self, n_clusters: int) -> None:
        super().__init__()
        self.centroids = nn.Parameter(torch.empty(n_clusters, VGG16_CHANNELS), requires_grad=False)
        self.conv = nn.Conv2d(VGG16_CHANNELS, n_clusters, 1, bias=False)

    def assign(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Turn features (n, channels, h, w) into unit vectors and their shares in each cluster (n, clusters, h, w).

        In float32 whatever the precision of the network.
        """
        local = functional.normalize(features.float(), dim=1)
        scores = self.conv.weight.float().flatten(1) @ local.flatten(2)
        return local, functional.softmax(scores, dim=1).reshape(*scores.shape[:2], *features.shape[2:])

    def gather_residuals(self, local: Tensor, shares: Tensor) -> Tensor:
        """Return the sum of residuals, (n, clusters, channels): sum_i a_ik x_i - (sum_i a_ik) c_k."""
        shares = shares.flatten(2)
        return shares @ local.flatten(2).transpose(1, 2) - shares.sum(2, keepdim=True) * self.centroids.float()


class Network(nn.Module):
    """Images (n, 3, height, width) to unit vectors (n, n_dimensions), float32; parameters are named as published."""

    def __init__(
        self,
        clusters: int,
        components: int | None,  # of the whitening; None: there is none
        *,
        mean: tuple[float, ...] | None = None,  # RGB levels that the network sees images less of; None: ImageNet's
        cluster_fastest: bool = False,
        n_dimensions: int | None = None,
    ) -> None:
        super().__init__()
        self.encoder = build_vgg16(last_pool=False)
        self.pool = Clusters(clusters)
        self.WPCA = None if components is None else nn.Sequential(nn.Conv2d(clusters * VGG16_CHANNELS, components, 1))
        self.mean = mean
        self.cluster_fastest = cluster_fastest
        self.n_dimensions = n_dimensions

    def forward(self, images: Tensor) -> Tensor:
        """Describe images."""
        vectors = self.describe_residuals(self.pool.gather_residuals(*self.pool.assign(self.encoder(images))))
        return vectors if self.n_dimensions is None else functional.normalize(vectors[:, : self.n_dimensions], dim=1)

    def describe_residuals(self, residuals: Tensor) -> Tensor:
        """Turn sums of residuals (n, clusters, channels) into unit vectors: the VLAD, whitened if asked."""
        columns = functional.normalize(residuals, dim=2)
        columns = columns.transpose(1, 2) if self.cluster_fastest else columns
        vectors = functional.normalize(columns.flatten(1), dim=1)
        if self.WPCA is None:
            return vectors
        projection = cast(nn.Conv2d, self.WPCA[0])
        whitened = functional.linear(vectors.to(projection.weight.dtype), projection.weight.flatten(1), projection.bias)
        return functional.normalize(whitened.float(), dim=1)


def read_struct(path: Path) -> tuple[dict[str, Tensor], tuple[float, ...]]:
    """Return the tensors of a MatConvNet network, under the other families' names, and the mean of its images.

    Raises BadInput for all but a .mat that holds the network as plain structs: the authors' originals hold objects of
    MATLAB classes.
    """
    wanted = "wanted a MatConvNet network converted to plain structs, such as Pitts30K_struct.mat"
    try:
        net = read_mat(path, ["net"])["net"]
        mean = np.asarray(net["meta"]["normalization"]["averageImage"], np.float64).reshape(-1, 3)[0]
        tensors = _name_tensors(net["layers"])
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror or error}): {wanted}") from error
    except Exception as error:  # whatever a damaged file, or a network of another layout, leads to
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise BadInput(f"{path} is no such file ({reason}): {wanted}, not the authors' original") from error
    return tensors, tuple(mean.tolist())


def _name_tensors(layers: Any) -> dict[str, Tensor]:
    """Return the tensors of MatConvNet's layers as a checkpoint of PyTorch has them."""
    if len(layers) != _MATCONVNET_LAYERS:
        raise ValueError(f"{len(layers)} layers instead of {_MATCONVNET_LAYERS}")
    tensors: dict[str, Tensor] = {}
    for number in range(_VGG16_LAYERS):
        held = np.atleast_1d(layers[number].get("weights", ()))
        if len(held):
            tensors[f"encoder.{number}.weight"] = torch.from_numpy(held[0].transpose(3, 2, 0, 1))
            tensors[f"encoder.{number}.bias"] = torch.from_numpy(np.atleast_1d(held[1]))
    assignment, minus_centroids = layers[_MATCONVNET_VLAD]["weights"]  # each (channels, clusters)
    tensors["pool.conv.weight"] = torch.from_numpy(assignment).T[:, :, None, None]
    tensors["pool.centroids"] = -torch.from_numpy(minus_centroids).T
    projection, bias = layers[_MATCONVNET_WHITENING]["weights"]  # (channels * clusters, components)
    tensors["WPCA.0.weight"] = torch.from_numpy(projection).T[:, :, None, None]
    tensors["WPCA.0.bias"] = torch.from_numpy(np.atleast_1d(bias))
    return tensors


def read_sizes(tensors: Tensors, file: str) -> tuple[int, int]:
    """Return the clusters and components of tensors; without a tensor, of the published file of a name."""
    found = re.search(r"WPCA(\d+)", file)
    return (
        read_size(tensors, "pool.centroids", 0, 16 if file.startswith("mapillary") else 64),
        read_size(tensors, "WPCA.0.bias", 0, int(found[1]) if found else 4096),
    )
