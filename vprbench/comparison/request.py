"""What a comparison was asked for: its own options, those of its methods, of the dataset, and of all its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from vprbench.errors import BadInput
from vprbench.paper.run_options import RunOptions
from vprbench.plugins.options import chosen
from vprbench.runs.corruption import corruptions
from vprbench.runs.settings import KNOWN
from vprbench.text import near


@dataclass(frozen=True, kw_only=True)
class Request(RunOptions):
    """Which methods are compared, and how; raises BadInput for what cannot be."""

    methods: list[str]  # names; NAME.option=value sets an option of one of them
    seeds: int = 1  # of each method that learns from a seed
    corruptions: list[str] = field(default_factory=list)  # of query frames: all, kinds, or as in shift-1
    devices: list[str] = field(default_factory=lambda: ["cpu"])  # or device=cuda, for one
    name: str | None = None  # of the files that are written, and the title; None: the dataset's

    def __post_init__(self) -> None:
        """Check what can be checked before a method or the dataset is built."""
        super().__post_init__()
        if not self.methods:
            raise BadInput("methods= is empty: name what is compared, as in methods=sad,hog")
        corruptions(self.corruptions)


@dataclass(frozen=True)
class SortedOptions:
    """The options of a comparison, by what they are of."""

    request: Request
    of_methods: Mapping[str, Sequence[str]]  # by the method's name, as method.option=value
    of_dataset: tuple[str, ...]
    of_runs: tuple[str, ...]  # as the command line has them


def sort_options(options: Sequence[str]) -> SortedOptions:
    """Sort the options of the command line; raises BadInput for those of no comparison."""
    own: list[str] = []
    of_dataset: list[str] = []
    rest: list[str] = []
    known = (*Request.__dataclass_fields__, "dataset", "device", *KNOWN)
    for option in options:
        name = option.partition("=")[0]
        if "." not in name and name not in known:
            raise BadInput(f"option {name} is unknown: {near(name, known)}")
        if name == "corruption":
            raise BadInput(
                f"{option}: give corruptions{option.removeprefix(name)}, beside which clean frames are asked"
            )
        if name.partition(".")[0] in ("method", "seed", "output", "save", "load", "readouts", "stream"):
            raise BadInput(
                f"{option}: a comparison takes methods=NAME,NAME and seeds=NUMBER, and NAME.option=value for an "
                "option of one of the methods"
            )
        if name == "device":
            own.append(f"devices{option.removeprefix('device')}")
        elif Request.has(option):
            own.append(option)
        else:
            (of_dataset if name.partition(".")[0] == "dataset" else rest).append(option)
    if not any(option.startswith("methods=") for option in own):
        raise BadInput("methods= is missing: name what is compared, as in methods=sad,hog; see vprbench list")
    if not any(option.startswith("dataset=") for option in of_dataset):
        raise BadInput("dataset= is missing: name the data, as in dataset=folders; see vprbench list")
    request = chosen(Request, own, {})
    methods = {name: [f"method{o.removeprefix(name)}" for o in rest if _is_of(o, name)] for name in request.methods}
    for name, given in methods.items():
        if run_wide := [o for o in given if o.partition("=")[0] in ("method.seed", "method.device")]:
            raise BadInput(
                f"{name}.{run_wide[0].removeprefix('method.')}: give seeds=NUMBER and device=, for all methods"
            )
    of_runs = [option for option in rest if not any(_is_of(option, name) for name in methods)]
    if not any(option.startswith("timing=") for option in of_runs):
        of_runs = ["timing=quick", *of_runs]
    of_runs += request.threads(of_runs)
    return SortedOptions(request, methods, tuple(of_dataset), tuple(of_runs))


def _is_of(option: str, name: str) -> bool:
    return option.partition("=")[0].startswith(f"{name}.")
