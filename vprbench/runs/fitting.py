"""How a method comes to its map: fitted and calibrated, or loaded; and how long that took."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from vprbench import progress
from vprbench.api.arrays import Places
from vprbench.api.dataset import Dataset, HeldOut
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, calibration
from vprbench.errors import BadInput
from vprbench.plugins import networks
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.experiment import Experiment
from vprbench.runs.notes import Note, make_notes
from vprbench.runs.stopwatch import Stopwatch


@dataclass(frozen=True)
class FitResult:
    """How a method came to its map, and how long that took."""

    fit_seconds: float | None = None
    fit_compute_seconds: float | None = None
    load_seconds: float | None = None
    notes: tuple[Note, ...] = ()
    from_cache: int = 0  # descriptors of references that were kept already
    of_earlier_run: bool = False  # whose method this run takes over: none of the time is its own

    @property
    def seconds(self) -> float:
        """Return the wall time of this run."""
        return 0.0 if self.of_earlier_run else (self.fit_seconds or 0.0) + (self.load_seconds or 0.0)

    @property
    def method_seconds(self) -> float:
        """Return the time of this run that went into the method."""
        own = (self.fit_compute_seconds or 0.0) + (self.load_seconds or 0.0)
        return 0.0 if self.of_earlier_run else max(0.0, own)


def fit_or_load(experiment: Experiment, key: str, stopwatch: Stopwatch, described: DescriptorCache | None) -> FitResult:
    """Load the method's network, or fit and calibrate the method and store its network if the request says where.

    A method that an earlier run of the experiment's `shared_fit` has fitted stays as it is.
    """
    if experiment.shared_fit:
        return replace(experiment.shared_fit[0], of_earlier_run=True)
    fitted = _fit_or_load(experiment, key, stopwatch, described)
    if experiment.shared_fit is not None:
        experiment.shared_fit.append(fitted)
    return fitted


def _fit_or_load(
    experiment: Experiment, key: str, stopwatch: Stopwatch, described: DescriptorCache | None
) -> FitResult:
    method, dataset, files = experiment.method, experiment.dataset, experiment.networks
    arguments = experiment.request.method
    if files.load is not None:
        progress.report("load", 0.0)
        wanted = networks.describe_origin(method, arguments, dataset)
        with stopwatch.lap() as load:
            notes = tuple(make_notes("loaded", networks.load_network(files.load, method, wanted)))
        return FitResult(load_seconds=load[0], notes=notes)
    networks.require_destination(files, method)
    given = calibration(method, dataset)
    held_out = None if given is None else _hide_names(given)
    read = [dataset.references, *([held_out.references, held_out.queries] if held_out else [])]
    before = _sum_reading_seconds(read)
    progress.report("fit", 0.0)
    with stopwatch.lap() as fit:
        from_cache = _fit(method, dataset, described)
        if held_out is not None:
            progress.report("calibrate", 0.0)
            try:
                method.calibrate(held_out)
            except BadInput as error:
                raise BadInput(f"choosing settings by held-out places: {error}") from error
    seconds = fit[0]
    computing = seconds - (_sum_reading_seconds(read) - before)
    if files.save is not None:
        origin = networks.describe_origin(method, arguments, dataset, key, seconds)
        networks.save_network(files, method, origin, dataset.references)
    calibrated: tuple[Note, ...] = ()
    if held_out is not None:
        text = f"calibrated on {len(held_out.queries)} held-out queries of {held_out.n_places} places"
        calibrated = (Note("calibrated", text),)
    if from_cache:
        return FitResult(load_seconds=seconds, notes=calibrated, from_cache=from_cache)
    return FitResult(fit_seconds=seconds, fit_compute_seconds=computing, notes=calibrated)


def _fit(method: Method, dataset: Dataset, described: DescriptorCache | None) -> int:
    """Fit a method; returns of how many references `described` had kept the descriptors already."""
    total = len(dataset.references)

    def report(done: int) -> None:
        progress.report("fit, reading images", done / total)

    places = _lock_places(dataset.places)
    if described is None:
        method.fit(dataset.references.watched(report), places)
        return 0
    assert isinstance(method, DescriptorMethod)
    method.require_index(total)
    descriptors, from_cache = described.descriptors(dataset.references, method.encode, report)
    method.fit_encoded(descriptors, places)
    return from_cache


def _hide_names(held_out: HeldOut) -> HeldOut:
    """Return the same places as a method may see them: under names that say nothing, not to be written to."""
    return HeldOut(
        references=held_out.references.unnamed(),
        places=_lock_places(held_out.places),
        queries=held_out.queries.unnamed(),
        right=_lock_places(held_out.right),
        in_map=held_out.in_map,
    )


def _sum_reading_seconds(read: Iterable[Images]) -> float:
    """Return how long somebody waited for images; views of one sequence share their waiting, which counts once."""
    return sum(waiting.seconds for waiting in {id(images.reading): images.reading for images in read}.values())


def _lock_places(places: Places) -> Places:
    view = places.view()
    view.flags.writeable = False
    return view
