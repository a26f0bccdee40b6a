"""The base of all published networks: a network in the sizes of its file's tensors, with their values or without."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from vprbench.api import BadInput, NeuralDescriptor, load_strictly, state_dict

Tensors = Mapping[str, Tensor]


@dataclass(kw_only=True)
class PublishedNetwork(NeuralDescriptor):
    """A descriptor whose network has the sizes that its file's tensors have; `network` is left to write."""

    @abstractmethod
    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network in the sizes of a file's tensors, and in the published ones if it holds no such tensor.

        It is called on the device "meta". Raises BadInput for sizes that the method's arguments exclude.
        """

    def name_parts(self, network: nn.Module) -> nn.Module:
        """Return the parts of a network under the names that the file has for them."""
        return network

    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file; raises BadInput for any other file."""
        return self.loaded(state_dict(path), path)

    def loaded(self, tensors: Tensors, path: Path) -> nn.Module:
        """Return the network with tensors that came from `path`; raises BadInput if they are another network's."""
        try:
            with torch.device("meta"):
                network = self.network(tensors)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        load_strictly(self.name_parts(network), tensors, path)
        return network

    def blank(self) -> nn.Module:
        """Return the network in its published sizes, on the device "meta"."""
        with torch.device("meta"):
            return self.network({})


def read_size(tensors: Tensors, name: str, axis: int, published: int) -> int:
    """Return a length of a file's tensor; the published one if the file has none, which strict loading then tells."""
    tensor = tensors.get(name)
    return published if tensor is None or tensor.ndim <= axis else tensor.shape[axis] or published


def select_prefix(tensors: Tensors, prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin with `prefix`, under the rest of their names."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
