"""The one face that methods, datasets and programs around them see: `from vprbench.api import Method, Images`.

A name is imported when it is asked for: what needs no torch does not wait for it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vprbench import progress
    from vprbench.api import checkpoints
    from vprbench.api.arrays import Image, Places, Scores
    from vprbench.api.compiling import compiled
    from vprbench.api.dataset import Dataset, FrameFolder, HeldOut
    from vprbench.api.descriptor import DescriptorMethod, best_image_of_place
    from vprbench.api.image_formats import IMAGE_SUFFIXES, is_beside, is_folder_beside, is_image_name, open_image
    from vprbench.api.images import Images, read_image
    from vprbench.api.method import LayerSpikes, Method
    from vprbench.api.neural import NeuralDescriptor
    from vprbench.api.preprocess import PatchNormalisation, Variant
    from vprbench.api.resize import Interpolation, Resize
    from vprbench.api.search import Audit, Search, faiss_module
    from vprbench.api.weights import (
        Weights,
        find_weights,
        load_strictly,
        read_tensor,
        read_weights,
        state_dict,
        without_prefix,
    )
    from vprbench.errors import BadInput, NotFittedError, NotThere, TrainingDivergedError
    from vprbench.storage.folders import checkout_folder, data_folder
    from vprbench.storage.mat_files import MatFileError, read_mat

#: The modules in which the names are at home.
HOMES = {
    **dict.fromkeys(("BadInput", "NotFittedError", "NotThere", "TrainingDivergedError"), "vprbench.errors"),
    **dict.fromkeys(("Image", "Places", "Scores"), "vprbench.api.arrays"),
    **dict.fromkeys(("compiled",), "vprbench.api.compiling"),
    **dict.fromkeys(("Dataset", "FrameFolder", "HeldOut"), "vprbench.api.dataset"),
    **dict.fromkeys(("DescriptorMethod", "best_image_of_place"), "vprbench.api.descriptor"),
    **dict.fromkeys(
        ("IMAGE_SUFFIXES", "is_beside", "is_folder_beside", "is_image_name", "open_image"), "vprbench.api.image_formats"
    ),
    **dict.fromkeys(("Images", "read_image"), "vprbench.api.images"),
    **dict.fromkeys(("LayerSpikes", "Method"), "vprbench.api.method"),
    **dict.fromkeys(("NeuralDescriptor",), "vprbench.api.neural"),
    **dict.fromkeys(("PatchNormalisation", "Variant"), "vprbench.api.preprocess"),
    **dict.fromkeys(("Interpolation", "Resize"), "vprbench.api.resize"),
    **dict.fromkeys(("Audit", "Search", "faiss_module"), "vprbench.api.search"),
    **dict.fromkeys(
        ("Weights", "find_weights", "load_strictly", "read_tensor", "read_weights", "state_dict", "without_prefix"),
        "vprbench.api.weights",
    ),
    **dict.fromkeys(("checkout_folder", "data_folder"), "vprbench.storage.folders"),
    **dict.fromkeys(("MatFileError", "read_mat"), "vprbench.storage.mat_files"),
}
MODULES = {"checkpoints": "vprbench.api.checkpoints", "progress": "vprbench.progress"}

__all__ = [
    "IMAGE_SUFFIXES",
    "Audit",
    "BadInput",
    "Dataset",
    "DescriptorMethod",
    "FrameFolder",
    "HeldOut",
    "Image",
    "Images",
    "Interpolation",
    "LayerSpikes",
    "MatFileError",
    "Method",
    "NeuralDescriptor",
    "NotFittedError",
    "NotThere",
    "PatchNormalisation",
    "Places",
    "Resize",
    "Scores",
    "Search",
    "TrainingDivergedError",
    "Variant",
    "Weights",
    "best_image_of_place",
    "checkout_folder",
    "checkpoints",
    "compiled",
    "data_folder",
    "faiss_module",
    "find_weights",
    "is_beside",
    "is_folder_beside",
    "is_image_name",
    "load_strictly",
    "open_image",
    "progress",
    "read_image",
    "read_mat",
    "read_tensor",
    "read_weights",
    "state_dict",
    "without_prefix",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for; raises AttributeError for a name that the face does not have."""
    if name in MODULES:
        return importlib.import_module(MODULES[name])
    if name not in HOMES:
        raise AttributeError(f"vprbench.api has no {name}: there are {', '.join(__all__)}")
    return getattr(importlib.import_module(HOMES[name]), name)
