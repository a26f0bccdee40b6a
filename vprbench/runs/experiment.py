"""A run that is ready to be made: the method and the dataset of its request built and checked, their files hashed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.data.doctor import check_dataset
from vprbench.errors import BadInput
from vprbench.plugins import loose, networks, registry
from vprbench.plugins.tuned_places import find_tuned_queries
from vprbench.progress import show_progress
from vprbench.runs import machine, sequences, stream
from vprbench.runs.corruption import corrupt_queries
from vprbench.runs.identity import DataRecord, hash_code, hash_frames, run_key
from vprbench.runs.request import RunRequest
from vprbench.runs.viewpoints import Viewpoints, parse_viewpoints, record_viewpoints
from vprbench.storage.hashes import hash_file

if TYPE_CHECKING:
    from vprbench.runs.fitting import FitResult


@dataclass(frozen=True)
class Experiment:
    """The parts of a run, built and checked."""

    request: RunRequest
    method: Method
    dataset: Dataset  # its queries corrupted, if the request says so
    fingerprint: str  # of the dataset
    data: DataRecord  # of the dataset
    networks: networks.Files = field(default_factory=networks.Files)  # to load or to store
    files: Sequence[tuple[str, str]] = ()  # name and hash of each data file behind the method
    cache: Path | None = None  # a folder for descriptors worth keeping
    stream: int = 0  # places from one stop of a growing map to the next; 0: the map does not grow
    tuned_queries: list[int] = field(default_factory=list)  # that show frames which the method was tuned on
    fits: list[FitResult] = field(default_factory=list)  # of runs that share the method: the fit of the first

    @property
    def views(self) -> Viewpoints | None:
        """The viewpoints of each query; None: the frames as they are."""
        return parse_viewpoints(self.request.views)

    @cached_property
    def config(self) -> dict[str, Any]:
        """The fields of the request that a stored run holds, and the files behind its method."""
        return {**self.request.record(), "files": [[*each] for each in self.files]}

    def key(self) -> str:
        """Return the hash of all that can change the outcome of the run."""
        return run_key(
            self.request,
            self.dataset,
            images=self.fingerprint,
            code=hash_code(type(self.method)),
            files=self.files,
            network=self.networks.sha256,
        )


def build_experiment(
    request: RunRequest, dataset: Dataset | None = None, make: Callable[[Mapping[str, Any]], Method] | None = None
) -> Experiment:
    """Build the method and the dataset of a request.

    Args:
        request: the run to be made.
        dataset: an object in place of the registered dataset.
        make: makes the method from its arguments; None: its registered class.

    Raises:
        BadInput: an option, the data or this machine does not fit; MissingData where weights or frames are missing.
    """
    for option in request.overrides:
        loose.register_loose_file(option)
    request.require_machine()
    machine.pin_threads(request.n_threads)
    if dataset is None:
        dataset = registry.make_dataset(request.dataset)
    files = networks.find_network_files(request.save, request.load, request.force)
    method = (make or registry.make_method)(request.method)
    if method.adapt != "none" and not method.adapts:
        raise BadInput(f"method.adapt={method.adapt}: {type(method).__name__} has no codes with a mean; use none")
    warnings = check_dataset(dataset, bool(sequences.parse_views(request.sequence, request.filter)))
    dataset = replace(dataset, notes=(*dataset.notes, *warnings))
    tuned_queries = find_tuned_queries(dataset, request.tuned_on)
    if isinstance(request.corruption, str):
        dataset = corrupt_queries(dataset, request.corruption)
    dataset = record_viewpoints(dataset, parse_viewpoints(request.views))
    with show_progress(request.method_name):  # frames may have to be hashed, and a file be downloaded
        dataset_hash, data = hash_frames(dataset)
        behind = [(path.name, hash_file(path)) for path in registry.list_data_files(method, request.method)]
        return Experiment(
            request,
            method,
            dataset,
            dataset_hash,
            data,
            files,
            behind,
            cache=Path(request.results).expanduser().absolute() / "descriptors" if request.cache else None,
            stream=stream.parse_step(request.stream, method, dataset.n_places),
            tuned_queries=tuned_queries,
        )


def corrupt_experiment(clean: Experiment, corruption: str) -> Experiment:
    """Return the same experiment on corrupted query frames; the method of both is fitted once."""
    dataset = corrupt_queries(clean.dataset, corruption)
    dataset_hash, data = hash_frames(dataset)
    request = clean.request.with_corruption(corruption)
    return replace(clean, request=request, dataset=dataset, fingerprint=dataset_hash, data=data)
