"""Trained modules as VPRSNN's authors store them, read without running anything out of their files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, MissingData

_NAME = re.compile(r"(?P<size>weights_ne\d+_L(?P<places>\d+))_offset(?P<offset>\d+)(?P<seed>_S\d+)?")
_LARGEST_VOLTS = 1.0  # thresholds grow by tens of millivolts; more are not in volts


@dataclass(frozen=True)
class PublishedModule:
    """What one module has learnt."""

    weights: npt.NDArray[np.float64]  # (n_inputs, n_neurons) from an input to an excitatory neuron
    theta_mv: npt.NDArray[np.float64]  # (n_neurons,) how much each threshold is raised


def find_files(folder: Path) -> list[Path]:
    """Return the files that `read_modules` reads, module by module; raises MissingData where one is missing."""
    files = [module / name for module in _find_modules(folder) for name in ("XeAe.npy", "theta_A.npy")]
    for path in files:
        if not path.is_file():
            raise MissingData(f"method.published_weights: {path} is missing: put the authors' file there")
    return files


def read_modules(folder: Path, n_inputs: int, n_neurons: int) -> list[PublishedModule]:
    """Return the modules in the sub-folders `weights_ne<neurons>_L<places>_offset<first place>`, first place first.

    `XeAe.npy` holds a row (input, neuron, weight) for each synapse, in any order, or all weights as
    (n_inputs, n_neurons); `theta_A.npy` the thresholds (n_neurons,) in volts. Pickled objects are refused.
    Raises MissingData where a file or a module is missing, and BadInput for a file that holds anything else.
    Source: the files that VPRSNN (QVPR/VPRSNN) stores after training.
    """
    files = find_files(folder)
    return [
        PublishedModule(_read_weights(weights, n_inputs, n_neurons), _read_theta_mv(theta, n_neurons))
        for weights, theta in zip(files[::2], files[1::2], strict=True)
    ]


def _find_modules(folder: Path) -> list[Path]:
    """Return the folders of the modules in the order of their first places."""
    found = [match for path in folder.glob("*/") if (match := _NAME.fullmatch(path.name))]
    if not found:
        raise MissingData(f"method.published_weights={folder}: no folder weights_ne400_L25_offset0 or similar is there")
    kinds = sorted({match["size"] + (match["seed"] or "") for match in found})
    if len(kinds) > 1:
        raise BadInput(f"method.published_weights={folder}: give one folder for each network ({', '.join(kinds)})")
    found.sort(key=lambda match: int(match["offset"]))
    for before, after in pairwise(found):
        end = int(before["offset"]) + int(before["places"])
        if end != int(after["offset"]):
            error = MissingData if end < int(after["offset"]) else BadInput
            raise error(
                f"method.published_weights={folder}: {before[0]} ends before place {end}, then comes {after[0]}"
            )
    return [folder / match[0] for match in found]


def _read_weights(path: Path, n_inputs: int, n_neurons: int) -> npt.NDArray[np.float64]:
    stored, n_synapses = _read_numbers(path), n_inputs * n_neurons
    if stored.shape == (n_synapses, 3):
        synapse = stored[:, :2] @ [n_neurons, 1]
        stored = stored[np.argsort(synapse)]
        if not np.array_equal(np.sort(synapse), np.arange(n_synapses)):
            raise BadInput(f"{path} has to have one row for each of {n_inputs} inputs and {n_neurons} neurons")
        stored = stored[:, 2].reshape(n_inputs, n_neurons)
    if stored.shape != (n_inputs, n_neurons) or not stored.min() >= 0:
        raise BadInput(
            f"{path} holds numbers of shape {stored.shape}; wanted weights, 0 or more, of {n_inputs} inputs and "
            f"{n_neurons} neurons, ({n_synapses}, 3) or ({n_inputs}, {n_neurons}): give the sizes of their training"
        )
    return np.ascontiguousarray(stored)


def _read_theta_mv(path: Path, n_neurons: int) -> npt.NDArray[np.float64]:
    volts = _read_numbers(path)
    if volts.shape != (n_neurons,) or not 0 <= volts.min() <= volts.max() < _LARGEST_VOLTS:
        raise BadInput(
            f"{path} holds numbers of shape {volts.shape}; wanted ({n_neurons},) thresholds in volts, 0 to "
            f"{_LARGEST_VOLTS:g} (0.02 before training)"
        )
    return 1000 * volts


def _read_numbers(path: Path) -> npt.NDArray[np.float64]:
    """Return the finite numbers of a file."""
    try:
        stored: npt.NDArray[Any] = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise BadInput(f"{path} is no array of plain numbers ({error}): get it anew from the authors") from error
    if stored.dtype.kind not in "fiu" or not np.isfinite(stored).all():
        raise BadInput(f"{path} holds {stored.dtype}; wanted finite numbers: get it anew from the authors")
    return stored.astype(np.float64)
