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
from vprbench.plugins.tuned_places import list_tuned_queries
from vprbench.progress import show_progress
from vprbench.runs import machine, stream
from vprbench.runs.corruption import corrupt_queries
from vprbench.runs.identity import DataRecord, hash_code, hash_content, hash_frames
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
    clean: Dataset  # the dataset before any corruption
    networks: networks.Files = field(default_factory=networks.Files)  # to load or to store
    files: Sequence[tuple[str, str]] = ()  # name and hash of each data file behind the method
    cache: Path | None = None  # a folder for descriptors worth keeping
    stream: int = 0  # places from one stop of a growing map to the next; 0: the map does not grow
    tuned_queries: list[int] = field(default_factory=list)  # that show frames which the method was tuned on
    fits: list[FitResult] = field(default_factory=list)  # of runs that share the method: the fit of the first

    @property
    def views(self) -> Viewpoints | None:
        """The viewpoints of each query; None: the frames as they are."""
        return None if self.request.views is None else parse_viewpoints(self.request.views)

    @cached_property
    def config(self) -> dict[str, Any]:
        """The fields of the request that a stored run holds, and the files behind its method."""
        return {**self.request.record(), "files": [[*each] for each in self.files]}

    def key(self) -> str:
        """Return the hash of all that can change the record of the run, but for its timing protocol."""
        request, dataset = self.request, self.dataset
        return hash_content(
            {
                "method": {k: v for k, v in request.method.items() if k not in ("_target_", "device")},
                "code": hash_code(type(self.method)),
                "dataset": dataset.name,
                "protocol": dict(dataset.protocol),
                "images": self.fingerprint,
                "breaks": [None if at is None else at.tolist() for at in (dataset.query_breaks, dataset.place_breaks)],
                "held_out": None if dataset.held_out is None else dataset.held_out.fingerprint(),
                "tuned_on": request.tuned_on,
                "files": [[*each] for each in self.files],
                "seed": request.seed,
                "device": machine.classify_device(request.device),
                "threads": request.n_threads,
                "depth": request.depth,
                "libraries": machine.list_library_versions(),
                "network": self.networks.sha256,
            }
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
        if ".py" in option:
            loose.register_loose_file(option)
    request.require_machine()
    machine.pin_threads(request.n_threads)
    clean = registry.make_dataset(request.dataset) if dataset is None else dataset
    method = (make or registry.make_method)(request.method)
    if method.adapt != "none" and not method.adapts:
        raise BadInput(f"method.adapt={method.adapt}: {type(method).__name__} has no codes with a mean; use none")
    with show_progress(request.method_name):  # frames may have to be hashed, and a file be downloaded
        shown = _show_queries(clean, request)
        dataset_hash, data = hash_frames(shown)
        return Experiment(
            request,
            method,
            shown,
            dataset_hash,
            data,
            clean=clean,
            networks=networks.find_network_files(request.save, request.load, request.force)
            if request.save or request.load
            else networks.Files(),
            files=[(path.name, hash_file(path)) for path in registry.list_data_files(method, request.method)],
            cache=Path(request.results).expanduser().absolute() / "descriptors" if request.cache else None,
            stream=stream.parse_step(request.stream, method, clean.n_places) if request.stream else 0,
        )


def corrupt_experiment(clean: Experiment, corruption: str) -> Experiment:
    """Return the same experiment on corrupted query frames; the method of both is fitted once."""
    request = clean.request.with_corruption(corruption)
    shown = _show_queries(clean.clean, request)
    dataset_hash, data = hash_frames(shown)
    return replace(clean, request=request, dataset=shown, fingerprint=dataset_hash, data=data)


def examine_dataset(experiment: Experiment) -> Experiment:
    """Return the experiment with the doctor's warnings, and with the queries of places that the method was tuned on.

    Raises BadInput for the doctor's first error.
    """
    request, clean = experiment.request, experiment.clean
    warnings = check_dataset(clean, bool(request.list_views()))
    dataset = replace(experiment.dataset, notes=(*clean.notes, *warnings))
    return replace(experiment, dataset=dataset, tuned_queries=list_tuned_queries(clean, request.tuned_on))


def _show_queries(clean: Dataset, request: RunRequest) -> Dataset:
    """Return a dataset whose queries are seen as a request wants: corrupted, and from several viewpoints."""
    dataset = corrupt_queries(clean, request.corruption) if isinstance(request.corruption, str) else clean
    return dataset if request.views is None else record_viewpoints(dataset, parse_viewpoints(request.views))
