"""A comparison before it runs: its options sorted, all of its cells looked at, all that is wrong told at once."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.config import make_request, split_sweep
from vprbench.data.doctor import check_dataset, look_at_some
from vprbench.errors import BadInput, MissingData, NotFittedError
from vprbench.plugins import registry
from vprbench.plugins.options import parse_options
from vprbench.progress import progress_shown, report
from vprbench.report.plan import PlannedColumn, Row
from vprbench.report.run_options import CompareRequest
from vprbench.report.selection import Frames, ResolvedColumn
from vprbench.runs.identity import fingerprint
from vprbench.runs.predictions import require_depth
from vprbench.runs.request import OPTIONS, RunRequest
from vprbench.runs.sequences import parse_views
from vprbench.runs.viewpoints import parse_viewpoints, record_viewpoints
from vprbench.text import suggest_names


@dataclass(frozen=True)
class SortedOptions:
    """The options of a comparison, by what they are of."""

    request: CompareRequest
    of_methods: Mapping[str, Sequence[str]]  # by the method's name, as method.option=value
    of_dataset: tuple[str, ...]
    of_runs: tuple[str, ...]  # as the command line has them


def sort_options(options: Sequence[str]) -> SortedOptions:
    """Sort the options of the command line; raises BadInput for those of no comparison."""
    own: list[str] = []
    of_dataset: list[str] = []
    rest: list[str] = []
    known = (*CompareRequest.__dataclass_fields__, "dataset", "device", *OPTIONS)
    for option in options:
        name = option.partition("=")[0]
        above = name.partition(".")[0]
        if above in CompareRequest.refused:
            raise BadInput(
                f"{option}: a comparison takes methods=NAME,NAME, seeds=NUMBER, corruptions=NAME,NAME, and "
                "NAME.option=value for an option of one of the methods"
            )
        if "." not in name and name not in known:
            raise BadInput(f"option {name} is unknown: {suggest_names(name, known)}")
        if name == "device":
            own.append(f"devices{option.removeprefix('device')}")
        elif CompareRequest.has(option):
            own.append(option)
        else:
            (of_dataset if above == "dataset" else rest).append(option)
    for name, given in (("methods", own), ("dataset", of_dataset)):
        if not any(option.startswith(f"{name}=") for option in given):
            raise BadInput(f"{name}= is missing: give names, as in methods=sad,hog dataset=folders; see vprbench list")
    request = parse_options(CompareRequest, own, {})
    methods: dict[str, list[str]] = {name: [] for name in request.methods}
    of_runs: list[str] = []
    for option in rest:
        above, dot, argument = option.partition("=")[0].partition(".")
        if dot and above in methods:
            if argument in ("seed", "device"):
                raise BadInput(f"{option}: give seeds=NUMBER and device=, for all methods")
            methods[above].append(f"method{option.removeprefix(above)}")
        elif dot and above not in OPTIONS:
            wanted = ", ".join(f"{name}.{argument}" for name in methods)
            raise BadInput(f"option {above}.{argument} is of no method here: give {wanted}")
        else:
            of_runs.append(option)
    if not any(option.startswith("timing=") for option in of_runs):
        of_runs = ["timing=quick", *of_runs]
    return SortedOptions(request, methods, tuple(of_dataset), (*of_runs, *request.threads(of_runs)))


@dataclass(frozen=True)
class Checked:
    """A comparison that was looked at."""

    column: ResolvedColumn
    rows: tuple[Row, ...]
    left_out: Mapping[str, str]  # the reason of each row that cannot run here, for its weights are not there
    request: RunRequest  # of its dataset, with the options of all runs
    dataset: Dataset | None  # None: it cannot be built, and only stored runs are asked for
    looked: str | None = None  # what a quick look at some frames found, and which command says more


def check_comparison(command: SortedOptions) -> tuple[Checked | None, list[str]]:
    """Return what a comparison consists of, and what is wrong with it, a line each; None if anything is.

    The dataset and every method are built, and weights are looked for. For stored=true nothing has to be there.
    """
    wrong: list[str] = []
    stored = command.request.stored
    options = [*command.of_dataset, *command.of_runs, f"device={command.request.devices[0]}"]
    request = make_request(options, {"results": command.request.results})
    if not command.request.is_distributed and not stored:
        request.require_machine()
    if wanted := command.request.predictions:
        require_depth(wanted, request.depth, wanted)
    dataset: Dataset | None = None
    frames, looked = None, None
    with progress_shown("compare"):
        try:
            dataset = record_viewpoints(registry.make_dataset(request.dataset), parse_viewpoints(command.request.views))
            check_dataset(dataset, bool(parse_views(command.request.sequence, command.request.filter)))
            frames = frames_of(dataset, request)
            looked = None if stored else _look_at_frames(dataset, command.of_dataset)
        except BadInput as error:
            wrong += [] if stored else [str(error)]
        rows: list[Row] = []
        left_out: dict[str, str] = {}
        for number, name in enumerate(command.of_methods):
            report(f"looking at {name}", number / len(command.of_methods))
            try:
                for given in split_sweep(command.of_methods[name]):
                    row, reason = _check_method(name, given, command, options, dataset)
                    rows.append(row)
                    left_out |= {row.name: reason} if reason else {}
            except BadInput as error:
                told = str(error).removeprefix(f"{name}: ").replace("method.", f"{name}.")
                wrong.append(f"{name}: {told}")
    if wrong:
        return None, wrong
    title = command.request.name or request.dataset_name
    planned = PlannedColumn(title, title, command.of_dataset)
    column = ResolvedColumn(planned, request.dataset, views=command.request.views, frames=frames)
    return Checked(column, tuple(rows), left_out, request, dataset, looked), []


def frames_of(dataset: Dataset, request: RunRequest) -> Frames:
    """Return the frames, places and threads by which runs on a dataset are known."""
    return Frames(fingerprint(dataset), dataset.protocol, request.n_threads)


def _look_at_frames(dataset: Dataset, options: Sequence[str]) -> str | None:
    """Return what a look at some frames found, and the command that looks at all of them; None: nothing."""
    found = look_at_some(dataset)
    return f"{'; '.join(found)}: {shlex.join(['vprbench', 'doctor', *options])} says more" if found else None


def _check_method(
    name: str, given: Sequence[str], command: SortedOptions, options: Sequence[str], dataset: Dataset | None
) -> tuple[Row, str]:
    """Return the row of a method with its `given` options, and why it cannot run here; raises BadInput for an error."""
    request = make_request([*options, f"method={name}", *given])
    entry = registry.entries("method").get(name)
    seeded = "seed" in (request.method if entry is None else entry.options)
    row = Row(
        " ".join([name, *(option.removeprefix("method.") for option in given)]),
        name,
        training="own" if seeded else "map",
        spiking=entry is not None and "spiking" in entry.tags,
        arguments=request.changed,
        seeds=tuple(range(command.request.seeds)) if seeded else (0,),
    )
    if command.request.stored:
        return row, ""
    try:
        method = registry.make_method(request.method)
        if dataset is not None and isinstance(method, DescriptorMethod):
            method.require_index(len(dataset.references))
        if not list(method.files()) and dataset is not None:
            with suppress(NotFittedError):
                method.encode(dataset.references[:1].unnamed())
    except MissingData as error:
        return row, str(error)
    except (BadInput, OSError):
        raise
    except Exception as error:  # whatever a plug-in raises
        raise BadInput(f"{type(error).__name__}: {error}") from error
    return row, ""
