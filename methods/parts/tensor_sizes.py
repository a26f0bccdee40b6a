"""Sizes of a network, read off the tensors of its file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from vprbench.api import BadInput


def n_outputs(tensors: Mapping[str, Tensor], path: Path, name: str) -> int:
    """Return the first length of a weight of `path`; raises BadInput where it is missing or no weight."""
    if name not in tensors:
        raise BadInput(f"{path} ({len(tensors)} tensors) holds no {name}: give the weights that belong to this method")
    if tensors[name].ndim < 2 or 0 in tensors[name].shape:
        raise BadInput(f"{path} holds {name} of shape {tuple(tensors[name].shape)}: wanted (outputs, inputs, ...)")
    return len(tensors[name])


def insist_on_size(path: Path, argument: str, asked: int, held: int) -> None:
    """Raise BadInput if the network of `path` holds another size than a method's argument asks for."""
    if held != asked:
        raise BadInput(
            f"{path} holds a network of {held} {argument.removeprefix('n_')}: set method.{argument}={held}, "
            f"or give weights of {asked}"
        )
