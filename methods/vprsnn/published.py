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
_WEIGHTS, _THETA = "XeAe.npy", "theta_A.npy"
_ADVICE = "get it anew from the authors"
_LARGEST_VOLTS = 1.0  # thresholds grow by tens of millivolts; more are not in volts


@dataclass(frozen=True)
class PublishedModule:
    """What one module has learnt."""

    weights: npt.NDArray[np.float64]  # (n_inputs, n_neurons) from an input to an excitatory neuron
    theta_mv: npt.NDArray[np.float64]  # (n_neurons,) how much each threshold is raised


def files_of(folder: Path) -> list[Path]:
    """Return the files that `read_modules` reads, module by module; raises MissingData where one is missing."""
    files = [module / name for module in _modules(folder) for name in (_WEIGHTS, _THETA)]
    for path in files:
        if not path.is_file():
            raise MissingData(f"{path} is missing: put the authors' file there")
    return files


def read_modules(folder: Path, n_inputs: int, n_neurons: int) -> list[PublishedModule]:
    """Return the modules in the sub-folders `weights_ne<neurons>_L<places>_offset<first place>`, first place first.

    `XeAe.npy` holds a row (input, neuron, weight) for each synapse, in any order, or all weights as
    (n_inputs, n_neurons); `theta_A.npy` the thresholds (n_neurons,) in volts. Pickled objects are refused.
    Raises MissingData where a file or a module is missing, and BadInput for a file that is not what is wanted.
    Source: what VPRSNN (QVPR/VPRSNN) stores after training.
    """
    files = files_of(folder)
    return [
        PublishedModule(_weights(weights, n_inputs, n_neurons), _theta_mv(theta, n_neurons))
        for weights, theta in zip(files[::2], files[1::2], strict=True)
    ]


def _modules(folder: Path) -> list[Path]:
    """Return the folders of the modules in the order of their first places."""
    try:
        found = [match for path in sorted(folder.iterdir()) if path.is_dir() and (match := _NAME.fullmatch(path.name))]
    except OSError as error:
        raise MissingData(
            f"{folder} cannot be read ({error.strerror}): give the folder of the authors' weights"
        ) from error
    if not found:
        raise MissingData(f"{folder} holds no folder such as weights_ne400_L25_offset0: give the one that holds them")
    kinds = sorted({match["size"] + (match["seed"] or "") for match in found})
    if len(kinds) > 1:
        raise BadInput(
            f"{folder} holds modules of {len(kinds)} networks ({', '.join(kinds)}): give one folder for each"
        )
    found.sort(key=lambda match: int(match["offset"]))
    for before, after in pairwise(found):
        next_offset = int(before["offset"]) + int(before["places"])
        if int(after["offset"]) < next_offset:
            raise BadInput(f"{folder}: {before[0]} and {after[0]} hold the same places: leave one of them there")
        if int(after["offset"]) > next_offset:
            raise MissingData(
                f"{folder} lacks the module from place {next_offset}, before {after[0]}: put it there too"
            )
    return [folder / match[0] for match in found]


def _weights(path: Path, n_inputs: int, n_neurons: int) -> npt.NDArray[np.float64]:
    stored = _array(path)
    if stored.shape == (n_inputs, n_neurons):
        weights = np.array(stored, np.float64, order="C")
    elif stored.shape == (n_inputs * n_neurons, 3):
        weights = _from_rows(path, stored, n_inputs, n_neurons)
    else:
        raise BadInput(
            f"{path} has shape {stored.shape}; {n_inputs} inputs and {n_neurons} neurons have "
            f"({n_inputs * n_neurons}, 3) or ({n_inputs}, {n_neurons}): give the sizes that it was trained with"
        )
    if not (np.isfinite(weights).all() and weights.min() >= 0):
        raise BadInput(f"{path} holds weights that are negative or not finite: {_ADVICE}")
    return weights


def _from_rows(path: Path, rows: npt.NDArray[Any], n_inputs: int, n_neurons: int) -> npt.NDArray[np.float64]:
    """Return the weights as a matrix; each synapse has to have one row."""
    given = np.array(rows[:, :2], np.float64)
    inside = (given >= 0) & (given < [n_inputs, n_neurons]) & (given == np.floor(given))
    if not inside.all():
        source, neuron = given[~inside.all(axis=1)][0]
        raise BadInput(
            f"{path} has a row of input {source:g} and neuron {neuron:g}; "
            f"wanted whole numbers below {n_inputs} and {n_neurons}: {_ADVICE}"
        )
    synapse = given.astype(np.int64) @ [n_neurons, 1]
    seen = np.bincount(synapse, minlength=n_inputs * n_neurons)
    if not (seen == 1).all():
        source, neuron = divmod(int(np.argmax(seen != 1)), n_neurons)
        raise BadInput(
            f"{path} has {seen[source * n_neurons + neuron]} rows of input {source} and neuron {neuron}; "
            f"wanted one: {_ADVICE}"
        )
    weights = np.empty(n_inputs * n_neurons)
    weights[synapse] = rows[:, 2]
    return weights.reshape(n_inputs, n_neurons)


def _theta_mv(path: Path, n_neurons: int) -> npt.NDArray[np.float64]:
    stored = _array(path)
    if stored.shape != (n_neurons,):
        raise BadInput(f"{path} has shape {stored.shape}; wanted ({n_neurons},), one threshold for each neuron")
    volts = np.array(stored, np.float64)
    if not (np.isfinite(volts).all() and volts.min() >= 0 and volts.max() < _LARGEST_VOLTS):
        raise BadInput(
            f"{path} holds thresholds from {volts.min():g} to {volts.max():g}; wanted volts, "
            f"0 to {_LARGEST_VOLTS:g} (0.02 before training): {_ADVICE}"
        )
    return 1000 * volts


def _array(path: Path) -> npt.NDArray[Any]:
    """Return the array of a file, not yet read: its shape is known before memory is taken for it."""
    try:
        stored: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
    except FileNotFoundError as error:
        raise MissingData(f"{path} is missing: put the authors' file there") from error
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): mend that") from error
    except Exception as error:  # numpy raises whatever a damaged header leads it to
        raise BadInput(
            f"{path} is no array of plain numbers ({_line(error)}), nothing else is read: {_ADVICE}"
        ) from error
    if stored.dtype.kind not in "fiu":
        raise BadInput(f"{path} holds {stored.dtype}; wanted an array of plain numbers: {_ADVICE}")
    return stored


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
