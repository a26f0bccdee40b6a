"""Trained networks as files: written whole or not at all, read without running anything out of them."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import save_file

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method, calibration
from vprbench.api.weight_files import is_plain, read_weights
from vprbench.errors import BadInput
from vprbench.plugins import nir_files
from vprbench.storage.atomic import remove_leftovers, unfinished
from vprbench.storage.tensors import Arrays, Seal, plain

FORMAT = 1
_OURS, _PUBLISHED = ".safetensors", ".pth"
_SEAL = Seal("vprbench", "vprbench_sha256")  # the text about a network: how it came about, as JSON
_UNCHECKED = "published network: neither its arguments nor its training images could be checked"


@dataclass(frozen=True)
class Files:
    """Where a run takes its network from, and where it leaves the network that it trained."""

    load: Path | None = None
    sha256: str | None = None  # of the file to load
    save: Path | None = None
    replace: bool = False  # a file that is there already


@dataclass(frozen=True)
class Origin:
    """What a network was trained with and on."""

    kind: str  # what `stored_as` names
    arguments: Mapping[str, Any]  # of the method, but for its device
    dataset: str
    n_places: int
    references: str  # hash of the reference images and their places
    held_out: str | None = None  # hash of the places that its settings were chosen by


@dataclass(frozen=True)
class Destination:
    """Where the network of a run goes, with what it is trained with and on."""

    path: Path
    replace: bool
    origin: Origin
    examples: Images  # references


def chosen_files(save: str | None, load: str | None, replace: bool) -> Files:
    """Return the files that a run was asked to use; raises BadInput if the one to load cannot be read."""
    source = None if load is None else Path(load).expanduser()
    return Files(
        load=source,
        sha256=None if source is None else _file_digest(source),
        save=None if save is None else Path(save).expanduser(),
        replace=replace,
    )


def keeps_a_network(method: Method) -> bool:
    """Tell whether what a method learns can be stored: whether its class has `state` and `restore` of its own."""
    return type(method).state is not Method.state and type(method).restore is not Method.restore


def origin(method: Method, arguments: Mapping[str, Any], dataset: Dataset) -> Origin:
    """Return the arguments and data that the network of a method, configured by `arguments`, is trained with."""
    digest = hashlib.sha256(dataset.references.fingerprint().encode())
    digest.update(dataset.places.tobytes())
    held_out = calibration(method, dataset)
    kept = {name: value for name, value in arguments.items() if name not in ("_target_", "device")}
    return Origin(
        kind=method.stored_as or type(method).__name__,
        arguments=json.loads(json.dumps(kept)),  # as it will be read: a tuple is a list
        dataset=dataset.name,
        n_places=dataset.n_places,
        references=digest.hexdigest(),
        held_out=None if held_out is None else held_out.fingerprint(),
    )


def prepare(files: Files, method: Method, arguments: Mapping[str, Any], dataset: Dataset) -> Destination | None:
    """Return where the network that is about to be trained goes, None for nowhere, and make the folder.

    Raises BadInput if it could not be stored: before the hour that the training may take.
    """
    path = files.save
    if path is None:
        return None
    _require_a_network(method)
    if path.suffix == nir_files.SUFFIX:
        nir_files.require_nir(path, method)
    elif path.suffix != _OURS:
        raise BadInput(f"save={path}: give a file that ends in {_OURS} or {nir_files.SUFFIX}")
    try:
        _refuse_to_replace(path, files.replace)
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent, f"-{path.name}")
        probe = unfinished(path.parent, f"-{path.name}")
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise BadInput(f"save={path} cannot be written ({error.strerror}): choose another file") from error
    chosen = np.linspace(0, len(dataset.references) - 1, min(nir_files.EXAMPLES, len(dataset.references))).astype(int)
    path = path.absolute()  # a method may change the working folder
    return Destination(path, files.replace, origin(method, arguments, dataset), dataset.references[chosen])


def save(to: Destination, method: Method, run_key: str, fit_seconds: float, fit_compute_seconds: float) -> None:
    """Store what a method has learnt; a reader sees the old file or the whole new one, never a part.

    Raises BadInput if the disk refuses, or if another run has stored its network there meanwhile.
    """
    description = {
        "format": FORMAT,
        "run": run_key,
        **asdict(to.origin),
        "fit_seconds": fit_seconds,
        "fit_compute_seconds": fit_compute_seconds,
    }
    text = json.dumps(description, sort_keys=True)
    state = {name: plain(array, f"{type(method).__name__}.state()[{name!r}]") for name, array in method.state().items()}
    partial = unfinished(to.path.parent, f"-{to.path.name}")
    try:
        if to.path.suffix == nir_files.SUFFIX:
            nir_files.write(partial, method, to.examples, text, state, _SEAL)
        else:
            save_file(state, partial, _SEAL.metadata(text, state))
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        _refuse_to_replace(to.path, to.replace or made_by(to.path) == run_key)
        partial.replace(to.path)
    except (OSError, SafetensorError) as error:
        raise BadInput(f"the network could not be stored in {to.path} ({error}): nothing was changed there") from error
    finally:
        partial.unlink(missing_ok=True)


def made_by(path: Path) -> str | None:
    """Return the key of the run that trained the network in a file, None if there is no whole one."""
    try:
        description, _ = _read(path)
    except BadInput:
        return None
    return str(description["run"])


def load(path: Path, method: Method, wanted: Origin, sha256: str | None = None) -> tuple[str, ...]:
    """Give a method what a file holds; returns what a reader of its numbers has to know.

    Raises BadInput for a file that is damaged, that changed since `sha256`, or that does not fit `wanted`.
    """
    _require_a_network(method)
    if sha256 not in (None, _file_digest(path)):
        raise BadInput(f"{path} changed while the run was prepared: run again")
    if path.suffix == _PUBLISHED:
        state, note = _published(path), _UNCHECKED
    else:
        description, state = _read(path)
        usual = {name: each.default for name, each in inspect.signature(type(method)).parameters.items()}
        differences = [*_differences(description, wanted, method.query_arguments, usual)]
        if differences:
            raise BadInput(
                f"{path} holds another network than this run needs: {'; '.join(differences)}; "
                "give what it was trained with and on, or train anew without load="
            )
        note = f"loaded network: run {description['run']} trained it in {description['fit_seconds']:.1f} s"
    try:
        method.restore(state)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return (note,)


def _differences(
    there: Mapping[str, Any], wanted: Origin, free: frozenset[str], usual: Mapping[str, Any]
) -> Iterator[str]:
    """Yield each difference between what a network was trained with and on and what is wanted.

    An argument that came after the network was stored may have its `usual` value.
    """
    if there["kind"].rpartition(".")[2] != wanted.kind:  # version 0.6 wrote the module of the class too
        yield f"it is one of {there['kind']}, not of {wanted.kind}"
        return  # the arguments of another method say nothing
    now = wanted.arguments
    before = {name: value for name, value in now.items() if name in usual and usual[name] == value}
    before |= there["arguments"]
    for name in sorted({*before, *now} - free):
        if not (name in before and name in now and before[name] == now[name]):
            yield f"method.{name} is {_shown(before, name)} there and {_shown(now, name)} here"
    if there["n_places"] != wanted.n_places:
        yield f"{there['n_places']} places there (dataset {there['dataset']}) and {wanted.n_places} here"
    elif there["references"] != wanted.references:
        yield f"other reference images or places (dataset {there['dataset']} there and {wanted.dataset} here)"
    elif None not in (there.get("held_out"), wanted.held_out) and there["held_out"] != wanted.held_out:
        yield "its settings were chosen by other held-out places"


def _shown(arguments: Mapping[str, Any], name: str) -> str:
    if name not in arguments:
        return "unknown"
    value = arguments[name]
    return value if isinstance(value, str) else json.dumps(value)


def _read(path: Path) -> tuple[dict[str, Any], Arrays]:
    """Return description and arrays; raises BadInput for a file that is not ours, damaged or of another layout."""
    try:
        text, state, whole = nir_files.read(path, _SEAL) if path.suffix == nir_files.SUFFIX else _SEAL.read(path)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(
            f"{path} cannot be read as a stored network ({reason}): restore the file or train anew"
        ) from error
    if text is None:
        raise BadInput(f"{path} was not stored by vprbench: it does not say what its network was trained with")
    try:
        description: dict[str, Any] = json.loads(text)
        layout = description["format"]
    except (ValueError, KeyError, TypeError):
        layout = FORMAT  # the digest tells that it is damaged
    if layout != FORMAT:
        raise BadInput(f"{path} has layout {layout}, this program reads {FORMAT}: train anew")
    if not whole:
        raise BadInput(f"{path} is not what was written: restore the file or train anew")
    return description, state


def _published(path: Path) -> Arrays:
    """Return the tensors of a file in the authors' layout, a dictionary of state dictionaries, under dotted names.

    Source: VPRTempo's public code saves {"model_0": state dictionary, ...} with torch.save. Raises BadInput for a file
    that is damaged, would have to run code, or holds anything else.
    """
    import torch

    try:
        content = read_weights(path)
    except BadInput as error:
        if not isinstance(error.__cause__, pickle.UnpicklingError):
            raise
        raise BadInput(
            f"{path} is damaged, or would have to run code of its own to be read, which is never done: "
            "give a file that holds tensors alone"
        ) from error
    found: dict[str, Any] = {}
    for name, value in content.items():
        found |= {f"{name}.{key}": part for key, part in value.items()} if isinstance(value, dict) else {name: value}
    for name, value in found.items():
        if not is_plain(value):
            kind = f"{value.layout} of {value.dtype}" if isinstance(value, torch.Tensor) else type(value).__name__
            raise BadInput(f"{path}: {name} is of type {kind}; wanted plain tensors in state dictionaries")
    return {name: value.detach().to(torch.float32, copy=True).numpy() for name, value in found.items()}


def _file_digest(path: Path) -> str:
    if path.suffix not in (_OURS, nir_files.SUFFIX, _PUBLISHED):
        raise BadInput(
            f"load={path}: give a stored network ({_OURS}, {nir_files.SUFFIX}) or a published one ({_PUBLISHED})"
        )
    try:
        if not path.is_file():
            raise BadInput(f"load={path} is no file: give one that save= wrote, or a published {_PUBLISHED}")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise BadInput(f"load={path} cannot be read ({error.strerror})") from error


def _require_a_network(method: Method) -> None:
    if not keeps_a_network(method):
        Method.state(method)  # which says so


def _refuse_to_replace(path: Path, replace: bool) -> None:
    if path.is_dir():
        raise BadInput(f"save={path} is a folder: give the name of a file in it")
    if path.exists() and not replace:
        raise BadInput(
            f"save={path} is there already: give another name (in a sweep one for each cell, as in "
            f"save='nets/vprtempo-${{seed}}{_OURS}'), or force=true to replace it"
        )
