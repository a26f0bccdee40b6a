"""Which of the wanted runs a store holds already, so that no process is started for them."""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from vprbench.api.dataset import Dataset
from vprbench.plugins import registry
from vprbench.plugins.opened_files import list_data_files, record_opened_files
from vprbench.progress import progress_shown
from vprbench.runs import thumbnails
from vprbench.runs.corrupted_frames import corrupted
from vprbench.runs.identity import Identity, code_hash_of, fingerprint
from vprbench.runs.record import Run
from vprbench.runs.run_files import content_key
from vprbench.runs.settings import checked_settings, n_threads
from vprbench.runs.store import Store
from vprbench.runs.viewpoints import seen_from, viewpoints
from vprbench.storage.hashes import content_hash

if TYPE_CHECKING:
    from vprbench.paper.missing_runs import MissingRun

logger = logging.getLogger(__name__)

Compose = Callable[[Sequence[str]], Mapping[str, Any]]  # options of the command line -> the configuration they make


class StoredRuns:
    """The runs of a store as they are when it is first asked."""

    def __init__(self, store: Store, options: Sequence[str], compose: Compose) -> None:
        """Compare with runs of these options, which `compose` makes a configuration of."""
        self._store = store
        self._options = options
        self._compose = compose
        self._datasets: dict[str, tuple[Dataset, str]] = {}

    def find(self, missing: MissingRun) -> Run | None:
        """Return the stored run that a process would find and have nothing to add to; None if there is none.

        Of several corruptions it is that of the last, if all are there. It has the key of a stored run; the frames
        behind the key are looked at only if the arguments are those of one. None for whatever raises an error here, so
        that a process tells it.
        """
        if not self._runs:
            return None
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                found = None
                for one in missing.each():
                    if (found := self._found(one)) is None:
                        break
                return found
        except (Exception, SystemExit) as error:  # whatever a plug-in raises, or an option that does not fit
            logger.debug("whether %s is stored is left to a process: %s", missing.row.name, error)
            return None

    @cached_property
    def _runs(self) -> list[Run]:
        return list(self._store.runs())

    def _found(self, missing: MissingRun) -> Run | None:
        config = dict(self._compose([*missing.options(), *self._options]))
        settings = checked_settings(config)
        config["method"], tuned_on = registry.declared(missing.row.method, config["method"])
        config["overrides"] = [*missing.options(), *self._options]
        alike = [
            run
            for run in self._runs
            if run.method == missing.row.method and _config_hash(run.config) == _config_hash(config)
        ]
        code = code_hash_of(config["method"]["_target_"])
        if settings.force or not alike or code is None:
            return None
        config["files"] = _hashed_weights(config["method"], alike)
        dataset, images = self._dataset(config["dataset"], config["corruption"])
        dataset = seen_from(dataset, viewpoints(config["views"]))
        held_out = [None, *([dataset.held_out.fingerprint()] if dataset.held_out else [])]
        of_class = config["method"]["_target_"].rpartition(".")[2]
        threads = n_threads(settings)
        keys = {Identity(of_class, code, config, dataset, images, h, threads).key() for h in held_out}
        found = [run for run in alike if run.dataset == dataset.name and run.key in keys and run.tuned_on == tuned_on]
        found = [run for run in found if run.tuned_queries is not None or not tuned_on]
        found = [run for run in found if not run.timed_by.shortfalls(settings.timing)]
        found = [run for run in found if run.scores is not None or not settings.scores]
        found = [run for run in found if run.energy is not None or not settings.energy]
        found = [
            run for run in found if run.query_breaks is not None or dataset.query_breaks is None
        ]  # it is told these
        if settings.frames and thumbnails.find(self._store.root, images) is None:
            return None
        return next((run for run in found if settings.cache or run.fit_seconds is not None), None)

    def _dataset(self, config: Mapping[str, Any], corruption: str | None) -> tuple[Dataset, str]:
        """Return a dataset and the fingerprint of its frames, which may have to be hashed."""
        key = content_key({"dataset": config, "corruption": corruption})
        if key not in self._datasets:
            with progress_shown(str(config["name"])):
                dataset = corrupted(registry.make_dataset(config), corruption)
                self._datasets[key] = dataset, fingerprint(dataset)
        return self._datasets[key]


def _config_hash(config: Mapping[str, Any]) -> str:
    """Return what is cheap to compare of a configuration, as a hash."""
    arguments = {name: value for name, value in config["method"].items() if name not in ("_target_", "device")}
    return content_key({"arguments": arguments, "seed": config["seed"], "depth": config["depth"]})


def _hashed_weights(arguments: Mapping[str, Any], stored: Sequence[Run]) -> list[list[str]]:
    """Return the weights of a method; one whose stored runs used none is not imported for it."""
    if not any(run.config["files"] for run in stored):
        return []
    with record_opened_files() as opened:
        method = registry.make_method(arguments)
    files = list_data_files(method, arguments, opened)
    return [[path.name, content_hash(path)] for path in files]
