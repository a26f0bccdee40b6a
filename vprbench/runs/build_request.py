"""From options to a request: the method and the dataset built and checked, the files behind both hashed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, get_args

from vprbench.api.adaptation import Adapt
from vprbench.api.dataset import Dataset
from vprbench.api.frame_cache import frames_kept
from vprbench.api.method import Method
from vprbench.data.doctor import check_dataset
from vprbench.errors import BadInput
from vprbench.plugins import networks, registry
from vprbench.plugins.opened_files import list_data_files, record_opened_files
from vprbench.plugins.tuned_frames import find_tuned_queries
from vprbench.progress import progress_shown
from vprbench.runs import machine, sequences, stream
from vprbench.runs.corrupted_frames import corrupted
from vprbench.runs.identity import Request, data_record, fingerprint, hashed
from vprbench.runs.settings import Settings, n_threads
from vprbench.runs.store import Store
from vprbench.runs.viewpoints import seen_from, viewpoints
from vprbench.storage.hashes import content_hash


def build_request(name: str, config: dict[str, Any], settings: Settings, store: Store) -> Request:
    """Return the request of method `name`, built from a configuration, which is told the method's final arguments.

    Raises BadInput for data that the cheap checks find wrong, and what the method and the dataset raise.
    """
    config["method"], tuned_on = registry.declared(name, config["method"])
    entry = registry.entries("method").get(name)
    if entry is not None:
        config["changed"] = entry.changed(config["method"])
    with frames_kept(settings.cache):
        dataset = registry.make_dataset(config["dataset"])
    return request_of(name, registry.make_method, dataset, config, settings, store, tuned_on)


def _require_adaptable(method: Method) -> None:
    """Raise BadInput for an argument `adapt` that is unknown, and for one of a method without centred codes."""
    if method.adapt == "none":
        return
    if method.adapt not in get_args(Adapt):
        raise BadInput(f"method.adapt={method.adapt}: give {', '.join(get_args(Adapt))}")
    if not method.adapts:
        raise BadInput(
            f"method.adapt={method.adapt}: {type(method).__name__} has no codes that a mean can be taken off"
        )


def corrupted_request(request: Request, corruption: str, config: Mapping[str, Any]) -> Request:
    """Return the request of a run on corrupted query frames, of which `config` records what was asked for.

    It has the same method, which is fitted once if the request has a `shared_fit`.
    """
    dataset = corrupted(request.dataset, corruption)
    frames = hashed(dataset)
    images, data = fingerprint(dataset, frames), data_record(dataset, frames)
    recorded = {**request.config, "corruption": corruption, "overrides": config["overrides"]}
    return replace(request, dataset=dataset, config=recorded, fingerprint=images, data=data)


def request_of(
    name: str,
    build: Callable[[Mapping[str, Any]], Method],
    dataset: Dataset,
    config: dict[str, Any],
    settings: Settings,
    store: Store,
    tuned_on: Mapping[str, Any],
) -> Request:
    """Return the request of a method, which `build` makes of its arguments, on a dataset that is built.

    Raises BadInput for data that the cheap checks find wrong, and what `build` raises.
    """
    threads = n_threads(settings)
    machine.pin_threads(threads)
    files = networks.find_network_files(settings.save, settings.load, settings.force)
    with record_opened_files() as opened:
        method = build(config["method"])
    _require_adaptable(method)
    # what the cheap checks warn of is among the dataset's notes
    in_sequences = bool(sequences.views(settings.sequence, settings.filter))
    dataset = replace(dataset, notes=(*dataset.notes, *check_dataset(dataset, in_sequences)))
    tuned_queries = find_tuned_queries(dataset, tuned_on)
    if isinstance(settings.corruption, str):
        dataset = corrupted(dataset, settings.corruption)
    dataset = seen_from(dataset, views := viewpoints(settings.views))
    with progress_shown(name):  # frames may have to be hashed, and a file be downloaded
        frames = hashed(dataset)
        images, data = fingerprint(dataset, frames), data_record(dataset, frames)
        behind = list_data_files(method, config["method"], opened)
        config["files"] = [[path.name, content_hash(path)] for path in behind]
    return Request(
        name,
        method,
        dataset,
        config,
        images,
        settings.timing,
        threads,
        files,
        cache=store.root.absolute() / "descriptors" if settings.cache else None,
        stream=stream.step(settings.stream, method, dataset.n_places),
        views=views,
        data=data,
        tuned_on=tuned_on,
        tuned_queries=tuned_queries,
        shared_fit=[] if isinstance(settings.corruption, list) else None,
    )
