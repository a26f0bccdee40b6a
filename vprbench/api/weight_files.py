"""Files of weights, safetensors or torch, read without running anything out of them."""

from __future__ import annotations

import pickle
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vprbench.errors import BadInput
from vprbench.text import join_few

if TYPE_CHECKING:
    from torch import Tensor

_AROUND = ("model_state_dict", "state_dict", "model")  # the usual names of the tensors in a checkpoint
_WRAPPERS = re.compile(r"(?<![^.])(?:module|_orig_mod)\.")  # parts of names that torch's wrappers add
_BEFORE = "model."  # Lightning's beginning of all names
_PLAIN_KINDS = "?bBhHiIlLqQefdFDSU"  # of numpy.dtype


def _list_numpy_types() -> list[Any]:
    """Return NumPy's own types of plain numbers and text, under their names before NumPy 2 and since."""
    from numpy._core import multiarray

    functions = {"scalar": multiarray.scalar, "_reconstruct": multiarray._reconstruct}
    packages = ("core", "_core")
    named = [(call, f"numpy.{package}.multiarray.{name}") for package in packages for name, call in functions.items()]
    return [np.ndarray, np.dtype, *named, *{type(np.dtype(kind)) for kind in _PLAIN_KINDS}]


_ZIP = b"PK\x03\x04"


def read_weights(path: Path) -> dict[str, Any]:
    """Return the content of a file of safetensors or of torch, nested as it is there, on the CPU.

    Raises BadInput for a file that is damaged, no dictionary, or not to be read without running code out of it.
    """
    content = _read_content(path)
    if not isinstance(content, dict):
        raise BadInput(f"{path} holds one {type(content).__name__}; wanted a dictionary of tensors: give another file")
    return content


def state_dict(path: Path, *keys: str) -> dict[str, Tensor]:
    """Return the tensors of a file by name, without the wrappings of a training.

    They are those under the first of `keys` that is there, or under a usual one, or all at its top. `module.` of
    several devices and `_orig_mod.` of a compiled network are left out wherever a part of a name begins, `model.` of
    Lightning before every name. Raises BadInput as `read_weights` does, if anything but plain tensors is found there,
    and if two names become one.
    """
    content = read_weights(path)
    usual = (name for name in _AROUND if isinstance(content.get(name), Mapping))
    key = next((key for key in keys if key in content), next(usual, None))
    found = content if key is None else content[key]
    odd = [name for name, value in found.items() if not is_plain(value)] if isinstance(found, Mapping) else [key]
    if odd or not found:
        places = " or ".join([*dict.fromkeys([*keys, *_AROUND]), "its top"])
        raise BadInput(
            f"{path} does not hold tensors alone under {places} (it holds {join_few(content)}): give another"
        )
    named = {_WRAPPERS.sub("", name): value.detach() for name, value in found.items()}
    if len(named) < len(found):
        raise BadInput(f"{path} holds two networks, one with module. in its names: give a file with the tensors of one")
    while all(name.startswith(_BEFORE) for name in named):
        named = {name.removeprefix(_BEFORE): tensor for name, tensor in named.items()}
    return named


def read_tensor(path: Path) -> Tensor:
    """Return the one tensor that a file of torch holds; raises BadInput for anything else."""
    content = _read_content(path)
    if not is_plain(content):
        raise BadInput(f"{path} holds one {type(content).__name__}; wanted one tensor: give another file")
    return content.detach()  # type: ignore[no-any-return]


def _read_content(path: Path) -> Any:
    """Return the content of a file, whatever it is; raises BadInput if it cannot be read safely."""
    try:
        with path.open("rb") as file:
            start = file.read(512)
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): give a file with weights") from error
    if not start:
        raise BadInput(f"{path} is empty: delete it and get it anew")
    if start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        raise BadInput(f"{path} is a web page, no file of weights (a login page?): delete it and get it anew")
    if path.suffix == ".safetensors" or start[8:9] == b"{":
        return _content_of_safetensors(path)
    return _content_of_torch(path, mmap=start.startswith(_ZIP))


def _content_of_safetensors(path: Path) -> dict[str, Tensor]:
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except (OSError, SafetensorError, ValueError, KeyError) as error:
        raise BadInput(f"{path} cannot be read as safetensors ({_find_reason(error)}): get it anew") from error


def _content_of_torch(path: Path, mmap: bool) -> Any:
    import torch
    from torch import serialization

    try:
        with warnings.catch_warnings(), serialization.safe_globals(_list_numpy_types()):
            warnings.simplefilter("ignore")  # about what was written by an older torch
            return torch.load(path, weights_only=True, map_location="cpu", mmap=mmap)
    except pickle.UnpicklingError as error:
        needs = re.search(r"(?:GLOBAL|class) ([\w.]+)( whose module \S+ is blocked)?", str(error))
        if needs is None:
            raise BadInput(f"{path} is damaged, or no file of torch: delete it and get it anew") from error
        if needs[2]:
            raise BadInput(f"{path} would run {needs[1]} when it is read: it is no honest file, delete it") from error
        raise BadInput(
            f"{path} holds more than tensors ({needs[1]}) and could only be read "
            "by running code out of it, which is never done: where you trust its source, keep its tensors alone, in a "
            'sandbox, with python -c "import torch; '
            f"d = torch.load({str(path)!r}, weights_only=False, map_location='cpu'); "
            "d = d.get('model_state_dict', d.get('state_dict', d)); "
            "torch.save({name: value for name, value in d.items() if torch.is_tensor(value)}, 'tensors.pth')\", "
            "and give tensors.pth in its place"
        ) from error
    except Exception as error:  # torch raises whatever a damaged file leads it to
        raise BadInput(f"{path} cannot be read as a file of torch ({_find_reason(error)}): get it anew") from error


def _find_reason(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def is_plain(value: Any) -> bool:
    """Tell whether a value is a tensor of plain numbers: dense, not quantised, not complex."""
    import torch

    return (
        isinstance(value, torch.Tensor)
        and value.layout is torch.strided
        and not value.is_quantized
        and not value.is_complex()
    )
