"""The one face that methods, datasets and programs around them see: `from vprbench.api import Method, Images`.

A name is imported when a program asks for it, so a method without torch does not wait for torch.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vprbench.text import near

if TYPE_CHECKING:  # the one list of names: type checkers read it, and so does `_homes`
    from vprbench import progress as progress
    from vprbench.api import checkpoints as checkpoints
    from vprbench.api.arithmetic import takes as takes
    from vprbench.api.arrays import (
        Descriptors as Descriptors,
        Image as Image,
        Places as Places,
        Scores as Scores,
    )
    from vprbench.api.binary import BinaryMap as BinaryMap, BinaryMethod as BinaryMethod
    from vprbench.api.circuit import Circuit as Circuit, HasCircuit as HasCircuit
    from vprbench.api.compiling import compiled as compiled
    from vprbench.api.dataset import Dataset as Dataset, FrameFolder as FrameFolder, HeldOut as HeldOut
    from vprbench.api.decoding import read_image as read_image
    from vprbench.api.descriptor import (
        DescriptorMethod as DescriptorMethod,
        best_image_of_place as best_image_of_place,
    )
    from vprbench.api.image_formats import (
        IMAGE_SUFFIXES as IMAGE_SUFFIXES,
        is_beside as is_beside,
        is_folder_beside as is_folder_beside,
        is_image_name as is_image_name,
        open_image as open_image,
    )
    from vprbench.api.events import Counted as Counted, Events as Events, Recording as Recording
    from vprbench.api.events import counted as counted, event_frames as event_frames, hot_pixels as hot_pixels
    from vprbench.api.gabor import GaborBank as GaborBank
    from vprbench.api.hamming import packed as packed
    from vprbench.api.growing import Growing as Growing, insist_on_new_places as insist_on_new_places
    from vprbench.api.images import Images as Images
    from vprbench.api.frame_cache import frames_kept as frames_kept, kept_frames as kept_frames
    from vprbench.api.method import LayerSpikes as LayerSpikes, Method as Method
    from vprbench.api.neural import NeuralDescriptor as NeuralDescriptor
    from vprbench.api.oriented import OrientedEdges as OrientedEdges
    from vprbench.api.preprocess import PatchNormalisation as PatchNormalisation, Variant as Variant
    from vprbench.api.resize import Interpolation as Interpolation, Resize as Resize
    from vprbench.api.search import Audit as Audit, Search as Search
    from vprbench.api.search_indexes import faiss_module as faiss_module
    from vprbench.api.weight_files import (
        read_tensor as read_tensor,
        read_weights as read_weights,
        state_dict as state_dict,
    )
    from vprbench.api.weights import (
        Weights as Weights,
        find_weights as find_weights,
        load_strictly as load_strictly,
        without_prefix as without_prefix,
    )
    from vprbench.errors import (
        BadInput as BadInput,
        NotFittedError as NotFittedError,
        NotThere as NotThere,
        TrainingDivergedError as TrainingDivergedError,
    )
    from vprbench.storage.atomic import replace_bytes as replace_bytes
    from vprbench.storage.folders import checkout_folder as checkout_folder, data_folder as data_folder
    from vprbench.storage.mat_files import MatFileError as MatFileError, read_mat as read_mat
    from vprbench.storage.paths import Paths as Paths, natural_keys as natural_keys


def _homes() -> dict[str, str]:
    """Return for each name above the module that defines it, and for a module its own full name."""
    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    imports = [node for block in tree.body if isinstance(block, ast.If) for node in block.body]
    found = {
        alias.name: str(node.module) for node in imports if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    return {name: f"{home}.{name}" if home in ("vprbench", __name__) else home for name, home in found.items()}


HOMES = _homes()
__all__ = [*HOMES]


def __getattr__(name: str) -> Any:
    """Import the name that a program asks for; raises AttributeError, with the near names, for an unknown one."""
    if name not in HOMES:
        raise AttributeError(f"vprbench.api has no {name}: {near(name, HOMES)}")
    home = importlib.import_module(HOMES[name])
    return home if home.__name__.endswith(f".{name}") else getattr(home, name)
