"""Which of the wanted runs a store holds already, so that no process is started for them."""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.plugins import registry
from vprbench.progress import progress_shown
from vprbench.runs import thumbnails
from vprbench.runs.corruption import corrupt_queries
from vprbench.runs.get_or_run import list_missing_parts
from vprbench.runs.identity import code_hash_of, fingerprint, run_key
from vprbench.runs.record import Run
from vprbench.runs.request import RunRequest
from vprbench.runs.run_files import content_key
from vprbench.runs.store import Store
from vprbench.runs.viewpoints import parse_viewpoints, record_viewpoints
from vprbench.storage.hashes import content_hash

logger = logging.getLogger(__name__)


class StoredRuns:
    """The runs of a store as they are when it is first asked."""

    def __init__(self, store: Store) -> None:
        """Read nothing yet."""
        self._store = store
        self._datasets: dict[str, tuple[Dataset, str]] = {}

    def holds(self, request: RunRequest) -> bool:
        """Tell whether a process would find the run of a request, for each of its corruptions, with nothing to add.

        The frames behind a key are looked at only if the arguments are those of a stored run. False for whatever
        raises an error here, so that a process tells it.
        """
        if not self._runs or request.force:
            return False
        wanted = [request]
        if isinstance(request.corruption, list):
            wanted = [request.with_corruption(name) for name in request.corruptions]
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                return all(map(self._holds_one, wanted))
        except (Exception, SystemExit) as error:  # whatever a plug-in raises
            logger.debug("whether %s is stored is left to a process: %s", request.method_name, error)
            return False

    @cached_property
    def _runs(self) -> list[Run]:
        return list(self._store.runs())

    def _holds_one(self, request: RunRequest) -> bool:
        wanted = _hash_arguments(request.record())
        alike = [
            run for run in self._runs if run.method == request.method_name and _hash_arguments(run.config) == wanted
        ]
        code = code_hash_of(request.method["_target_"])
        if not alike or code is None:
            return False
        dataset, images = self._dataset(request.dataset, request.corruption)
        dataset = record_viewpoints(dataset, parse_viewpoints(request.views))
        key = run_key(
            request,
            dataset,
            images=images,
            code=code,
            files=_hash_files(request.method, alike),
            network=None,
        )
        if request.frames and thumbnails.load_thumbnails(self._store.root, images) is None:
            return False
        there = (run for run in alike if run.dataset == dataset.name and run.key == key)
        return any(not list_missing_parts(run, request) for run in there)

    def _dataset(self, config: Mapping[str, Any], corruption: Any) -> tuple[Dataset, str]:
        """Return a dataset and the fingerprint of its frames, which may have to be hashed."""
        key = content_key({"dataset": config, "corruption": corruption})
        if key not in self._datasets:
            with progress_shown(str(config.get("name", "dataset"))):
                dataset = corrupt_queries(registry.make_dataset(config), corruption)
                self._datasets[key] = dataset, fingerprint(dataset)
        return self._datasets[key]


def _hash_arguments(config: Mapping[str, Any]) -> str:
    """Return the hash of what is cheap to compare of a recorded request."""
    arguments = {name: value for name, value in config["method"].items() if name not in ("_target_", "device")}
    return content_key({"arguments": arguments, "seed": config["seed"], "depth": config["depth"]})


def _hash_files(arguments: Mapping[str, Any], stored: Sequence[Run]) -> list[tuple[str, str]]:
    """Return name and hash of each data file behind a method; one whose stored runs used none is not imported."""
    if not any(run.config["files"] for run in stored):
        return []
    method = registry.make_method(arguments)
    return [(path.name, content_hash(path)) for path in registry.list_data_files(method, arguments)]
