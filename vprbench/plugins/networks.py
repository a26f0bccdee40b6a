"""Trained networks as files: written whole or not at all, read without running anything out of them."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict
from safetensors import SafetensorError
from safetensors.numpy import load, save

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method, calibration
from vprbench.api.weight_files import is_plain, read_weights
from vprbench.errors import BadInput
from vprbench.plugins import nir_files
from vprbench.storage.atomic import remove_leftovers, replace_bytes
from vprbench.storage.hashes import hash_file
from vprbench.storage.tensors import Arrays, require_plain_numbers
from vprbench.text import format_seconds, join_names

_SUFFIXES, _PUBLISHED = (".safetensors", nir_files.SUFFIX), ".pth"  # of stored networks, of published ones
_METADATA = "vprbench"  # the entry of a file's metadata that holds the origin of its network, as JSON


@dataclass(frozen=True)
class Files:
    """The file that a run takes its network from, and the file that it leaves a trained network in."""

    load: Path | None = None
    sha256: str | None = None  # of the file to load
    save: Path | None = None
    replace: bool = False  # a file that is there already


class Origin(BaseModel):
    """The method, its arguments, and the data that a network was trained with."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal[2] = 2  # of the file
    kind: str  # `stored_as` of the method, or the name of its class
    arguments: dict[str, Any]  # of the method, but for its device
    dataset: str
    n_places: int
    references: str  # hash of the reference images and their places
    held_out: str | None = None  # hash of the places that its settings were chosen by
    run: str = ""  # key of the run that trained it
    fit_seconds: float = 0.0


def find_network_files(save: str | None, load: str | None, replace: bool) -> Files:
    """Return the files that the options of a run name; raises BadInput if the one to load cannot be read."""
    target = None if save is None else Path(save).expanduser().absolute()  # a method may change the working folder
    if load is None:
        return Files(save=target, replace=replace)
    source = Path(load).expanduser()
    if source.suffix not in (*_SUFFIXES, _PUBLISHED) or not source.is_file():
        raise BadInput(f"load={load}: give a stored network ({', '.join(_SUFFIXES)}) or a published one ({_PUBLISHED})")
    return Files(source, hash_file(source), target, replace)


def keeps_a_network(method: Method) -> bool:
    """Tell whether the class of a method overrides `state` and `restore`, so that a file can hold its network."""
    return type(method).state is not Method.state and type(method).restore is not Method.restore


def describe_origin(
    method: Method, arguments: Mapping[str, Any], dataset: Dataset, run_key: str = "", fit_seconds: float = 0.0
) -> Origin:
    """Return the origin of a network that a method, configured by `arguments`, learns on a dataset."""
    digest = hashlib.sha256(dataset.references.fingerprint().encode())
    digest.update(dataset.places.tobytes())
    held_out = calibration(method, dataset)
    kept = {name: value for name, value in arguments.items() if name not in ("_target_", "device")}
    return Origin(
        kind=method.stored_as or type(method).__name__,
        arguments=json.loads(json.dumps(kept)),  # as a file holds it: a tuple is a list
        dataset=dataset.name,
        n_places=dataset.n_places,
        references=digest.hexdigest(),
        held_out=None if held_out is None else held_out.fingerprint(),
        run=run_key,
        fit_seconds=fit_seconds,
    )


def require_destination(files: Files, method: Method) -> None:
    """Raise BadInput if the network could not be stored, before a training that may take an hour; make its folder."""
    path = files.save
    if path is None:
        return
    _require_network(method)
    if path.suffix not in _SUFFIXES:
        raise BadInput(f"save={path}: give a file that ends in {' or '.join(_SUFFIXES)}")
    if path.suffix == nir_files.SUFFIX:
        nir_files.require_circuit(path, method)
    try:
        _refuse_to_replace(path, files.replace)
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent)
        tempfile.TemporaryFile(dir=path.parent).close()  # the folder can be written to
    except OSError as error:
        raise BadInput(f"save={path} cannot be written ({error.strerror}): choose another file") from error


def save_network(files: Files, method: Method, origin: Origin, references: Images) -> None:
    """Store the state of a method in `files.save`; a reader sees the old file or the whole new one, never a part.

    Some of the `references` become the check vector of a file of NIR. Raises BadInput if the disk refuses or another
    run has stored a network there meanwhile, TypeError if `state` holds anything but arrays of numbers.
    """
    assert files.save is not None
    state = {
        name: require_plain_numbers(array, f"{type(method).__name__}.state()[{name!r}]")
        for name, array in method.state().items()
    }
    content = save(state, {_METADATA: json.dumps(origin.model_dump())})
    if files.save.suffix == nir_files.SUFFIX:
        content = nir_files.format_network(method, references, content)
    try:
        _refuse_to_replace(files.save, files.replace)
        replace_bytes(files.save, content)
    except OSError as error:
        raise BadInput(f"the network could not be stored in {files.save} ({error}): choose another file") from error


def read_run_key(path: Path) -> str | None:
    """Return the key of the run that trained the network in a file, None if there is no whole one."""
    try:
        return _read_network(path)[0].run
    except BadInput:
        return None


def load_network(path: Path, method: Method, wanted: Origin) -> tuple[str, ...]:
    """Give a method the state in a file; returns notes that a reader of its results needs.

    Raises BadInput if the file is damaged, or its origin is not the `wanted` one.
    """
    _require_network(method)
    if path.suffix == _PUBLISHED:
        state = _read_published(path)
        note = "published network: neither its arguments nor its training images could be checked"
    else:
        origin, state = _read_network(path)
        if differences := _list_differences(origin, wanted, method):
            remedy = "give what it was trained with and on, or train anew without load="
            raise BadInput(f"{path} holds another network than this run needs: {'; '.join(differences)}; {remedy}")
        note = f"loaded network: run {origin.run} trained it in {format_seconds(origin.fit_seconds)} s"
    try:
        method.restore(state)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return (note,)


def _list_differences(stored: Origin, wanted: Origin, method: Method) -> list[str]:
    """Return the differences between two origins, but for the arguments that only queries see."""
    if stored.kind != wanted.kind:
        return [f"it is one of {stored.kind}, not of {wanted.kind}"]  # its arguments mean other things
    found = []
    for name in sorted({*stored.arguments, *wanted.arguments} - method.query_arguments):
        there, here = stored.arguments.get(name, "unknown"), wanted.arguments.get(name, "unknown")
        if there != here:
            found.append(f"method.{name} is {json.dumps(there)} there and {json.dumps(here)} here")
    if stored.n_places != wanted.n_places:
        found.append(f"{stored.n_places} places there (dataset {stored.dataset}) and {wanted.n_places} here")
    elif stored.references != wanted.references:
        found.append(f"other reference images or places (dataset {stored.dataset} there and {wanted.dataset} here)")
    elif None not in (stored.held_out, wanted.held_out) and stored.held_out != wanted.held_out:
        found.append("its settings were chosen by other held-out places")
    return found


def _read_network(path: Path) -> tuple[Origin, Arrays]:
    """Return origin and arrays; raises BadInput for a file that is damaged or that this version did not store."""
    try:
        content = nir_files.read_stored_network(path) if path.suffix == nir_files.SUFFIX else path.read_bytes()
        state = load(content)
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        return Origin.model_validate_json(header.get("__metadata__", {}).get(_METADATA, "{}")), state
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, SafetensorError) as error:
        reason = str(error).partition("\n")[0]
        wanted = "restore the file, or train anew"
        raise BadInput(f"{path} is no network that this version stored, or is damaged ({reason}): {wanted}") from error


def _read_published(path: Path) -> Arrays:
    """Return the tensors of a file in the authors' layout, a dictionary of state dictionaries, under dotted names.

    Source: VPRTempo's public code saves {"model_0": state dictionary, ...} with torch.save. Raises BadInput for a file
    that is damaged, would have to run code, or holds anything else.
    """
    tensors: dict[str, Any] = {}
    for name, value in read_weights(path).items():
        tensors |= {f"{name}.{key}": part for key, part in value.items()} if isinstance(value, dict) else {name: value}
    if odd := [name for name, value in tensors.items() if not is_plain(value)]:
        raise BadInput(f"{path}: {join_names(odd)} hold no plain tensor; wanted state dictionaries of plain tensors")
    return {name: value.detach().float().clone().numpy() for name, value in tensors.items()}


def _require_network(method: Method) -> None:
    if not keeps_a_network(method):
        Method.state(method)  # raises the error that says so


def _refuse_to_replace(path: Path, replace: bool) -> None:
    if path.is_dir() or (path.exists() and not replace):
        raise BadInput(
            f"save={path} is there already: give another name, in a sweep one for each cell "
            "(save='nets/vprtempo-${seed}.safetensors'), or force=true to replace a file"
        )
