"""How a method comes to its map: fitted and calibrated, or loaded; and how long that took."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from vprbench import progress
from vprbench.api.arrays import Places
from vprbench.api.dataset import Dataset, HeldOut
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, calibration
from vprbench.plugins import networks
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.experiment import Experiment
from vprbench.runs.notes import Note, make_notes
from vprbench.runs.stopwatch import Stopwatch


@dataclass(frozen=True)
class FitResult:
    """How a method came to its map, and how long that took."""

    fit_seconds: float | None
    fit_compute_seconds: float | None
    load_seconds: float | None
    notes: tuple[Note, ...]
    seconds: float = 0.0  # of this run; none if it takes over the fit of an earlier one
    method_seconds: float = 0.0  # of these, the time that went into the method


def fit_or_load(experiment: Experiment, key: str, stopwatch: Stopwatch, described: DescriptorCache | None) -> FitResult:
    """Load the method's network, or fit and calibrate the method and store its network if the request says where.

    A method that an earlier run of the experiment has fitted stays as it is.
    """
    if experiment.fits:
        return replace(experiment.fits[0], seconds=0.0, method_seconds=0.0)
    if experiment.networks.load is not None:
        fitted = _load_network(experiment, experiment.networks.load, stopwatch)
    else:
        fitted = _fit_and_calibrate(experiment, key, stopwatch, described)
    experiment.fits.append(fitted)
    return fitted


def _load_network(experiment: Experiment, file: Path, stopwatch: Stopwatch) -> FitResult:
    method = experiment.method
    progress.report("load", 0.0)
    wanted = networks.describe_origin(method, experiment.request.method, experiment.dataset)
    with stopwatch.lap() as load:
        notes = make_notes("loaded", networks.load_network(file, method, wanted))
    return FitResult(None, None, load[0], tuple(notes), seconds=load[0], method_seconds=load[0])


def _fit_and_calibrate(
    experiment: Experiment, key: str, stopwatch: Stopwatch, described: DescriptorCache | None
) -> FitResult:
    method, dataset, files = experiment.method, experiment.dataset, experiment.networks
    networks.require_destination(files, method)
    given = calibration(method, dataset)
    held_out = None if given is None else _hide_names(given)
    read = [dataset.references, *([] if held_out is None else [held_out.references, held_out.queries])]
    before = _sum_reading_seconds(read)
    notes: tuple[Note, ...] = ()
    progress.report("fit", 0.0)
    with stopwatch.lap() as fit:
        from_cache = _fit_references(method, dataset, described)
        if held_out is not None:
            progress.report("calibrate", 0.0)
            method.calibrate(held_out)
            text = f"calibrated on {len(held_out.queries)} held-out queries of {held_out.n_places} places"
            notes = (Note("calibrated", text),)
    seconds = fit[0]
    computing = seconds - (_sum_reading_seconds(read) - before)
    if files.save is not None:
        origin = networks.describe_origin(method, experiment.request.method, dataset, key, seconds)
        networks.save_network(files, method, origin, dataset.references)
    if from_cache:
        return FitResult(None, None, seconds, notes, seconds, seconds)
    return FitResult(seconds, computing, None, notes, seconds, max(0.0, computing))


def _fit_references(method: Method, dataset: Dataset, described: DescriptorCache | None) -> int:
    """Fit a method; returns of how many references `described` had kept the descriptors already."""
    references, places = dataset.references, _lock_places(dataset.places)

    def report(done: int) -> None:
        progress.report("fit, reading images", done / len(references))

    if described is None:
        method.fit(references.watched(report), places)
        return 0
    assert isinstance(method, DescriptorMethod)
    method.require_index(len(references))
    descriptors, from_cache = described.descriptors(references, method.encode, report)
    method.fit_encoded(descriptors, places)
    return from_cache


def _hide_names(held_out: HeldOut) -> HeldOut:
    """Return the same places as a method may see them: under names that say nothing, not to be written to."""
    images = {part: getattr(held_out, part).unnamed() for part in ("references", "queries")}
    return replace(held_out, places=_lock_places(held_out.places), right=_lock_places(held_out.right), **images)


def _sum_reading_seconds(read: Iterable[Images]) -> float:
    """Return how long somebody waited for images; views of one sequence share their waiting, which counts once."""
    return sum(reading.seconds for reading in {images.reading for images in read})


def _lock_places(places: Places) -> Places:
    view = places.view()
    view.flags.writeable = False
    return view
