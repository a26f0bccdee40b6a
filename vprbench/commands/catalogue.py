"""The commands: one function each, which takes options and returns the exit code. Libraries are imported inside."""

from __future__ import annotations

import json
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, cast

from vprbench.errors import BadInput
from vprbench.text import near, printable

if TYPE_CHECKING:
    from vprbench.plugins.entries import Folder
    from vprbench.report.run_options import TableRequest


COMPLETE = "__complete"  # the hidden command of completion scripts: a line -> the words that its last may become


@dataclass(frozen=True)
class Command:
    """A command and its options."""

    call: Callable[[list[str]], int]  # its docstring says in the first sentence what it does
    options: str = ""  # module:Class, whose fields are its options
    groups: tuple[Folder, ...] = ()  # configurations that it takes, with their options: method, dataset, timing
    run: tuple[str, ...] | None = ()  # options of a run that it takes too; None: all that the class does not refuse
    words: str = ""  # before the options: NAME
    usual: Mapping[Folder, str] = field(default_factory=dict)  # by group, where it has another default than a run

    @property
    def meaning(self) -> str:
        """What it does, in a sentence."""
        return (self.call.__doc__ or "").partition("\n")[0].removesuffix(".")

    def option_class(self) -> type | None:
        """Import and return the class whose fields are its options; None if it has none of its own."""
        return cast(type, pkgutil.resolve_name(self.options)) if self.options else None


def run(options: list[str]) -> int:
    """Run one method on one dataset, or with -m all combinations, each in a process of its own."""
    from vprbench.commands.run import run_or_sweep

    return run_or_sweep(options)


def compare(options: list[str]) -> int:
    """Run methods on one dataset, rank them in a table, draw figures and write a page."""
    from vprbench.config import quote_options
    from vprbench.report.comparison.checks import sort_options
    from vprbench.report.comparison.make import make_comparison

    return make_comparison(sort_options(quote_options(options)))


def show_list(words: list[str]) -> int:
    """Show the methods and datasets, or those that fit: list spiking, list weights=none, list datasets."""
    from vprbench.plugins.entries import broken_plugins
    from vprbench.plugins.listing import Listing, list_entries
    from vprbench.plugins.options import parse_options
    from vprbench.terminal.console import console, show_table

    settings = parse_options(Listing, [word for word in words if "=" in word], {})
    found = list_entries([word for word in words if "=" not in word], settings.weights)
    if settings.output == "json":
        print(json.dumps([asdict(each) for each in found]))
        return 0
    for group in ("method", "dataset"):
        rows = [(each.name, each.summary) for each in found if each.kind == group]
        if rows:
            show_table([f"{group}s", ""], rows, settings.wide or not console().is_terminal)
    for provider, reason in broken_plugins() if not words else ():
        print(printable(f"plug-in {provider} BROKEN: {reason}"))
    return 0


def check(options: list[str]) -> int:
    """Test a method or dataset against the rules of the contract and count them.

    Raises BadInput if none is named.
    """
    from vprbench.config import make_request
    from vprbench.plugins import conformance, registry
    from vprbench.progress import progress_shown
    from vprbench.runs import machine

    groups = [group for group in ("method", "dataset") if any(option.startswith(f"{group}=") for option in options)]
    if len(groups) != 1:
        raise BadInput(f"check needs method=NAME or dataset=NAME; {near('', registry.entries('method'))}")
    request = make_request(options)
    request.require_machine()
    machine.pin_threads(request.n_threads)
    given = {option.split("=")[0].removeprefix("method.") for option in options}
    with progress_shown(request.method_name if groups == ["method"] else request.dataset_name):  # of a download
        if groups == ["method"]:
            results = list(conformance.check_method({**request.method, "tuned_on": request.tuned_on or None}, given))
        else:
            results = list(conformance.check_dataset(request.dataset))
    for result in results:
        print(printable(str(result)))
    kept, excepted, broken = (sum(r.state == state for r in results) for state in ("kept", "excepted", "broken"))
    print(f"{len(results)} rules: {kept} kept, {excepted} excepted, {broken} broken")
    return 1 if broken else 0


def new(options: list[str]) -> int:
    """Write the files of a new method or dataset, which keep the contract at once: new method NAME."""
    from vprbench.plugins.new import write_plugin

    print(printable(write_plugin(options), but="\n"))
    return 0


def doctor(options: list[str]) -> int:
    """Examine a dataset and say what is wrong with it and what to do.

    Raises BadInput if no dataset is named, and for options that are neither its own nor output=json.
    """
    from vprbench.config import make_request
    from vprbench.data.doctor import command
    from vprbench.plugins import registry
    from vprbench.progress import progress_shown
    from vprbench.terminal.streams import results_only_on_stdout

    if not any(option.startswith("dataset=") for option in options):
        raise BadInput(f"doctor needs dataset=NAME; {near('', registry.entries('dataset'))}")
    for option in options:
        if option.partition("=")[0].split(".")[0] not in ("dataset", "output"):
            raise BadInput(f"{option} is no option of doctor: it takes dataset=, dataset.OPTION= and output=json")
    request = make_request(options)
    with progress_shown(f"doctor, {request.dataset_name}"), results_only_on_stdout() as say:
        return command(
            request.dataset_name,
            lambda: registry.make_dataset(request.dataset),
            lambda text: say(printable(text, but="\n")),
            "json" if request.output == "json" else "text",
        )


def show_status(words: list[str]) -> int:
    """Show which runs of a results folder are made now and by whom, and how many are stored."""
    from vprbench.plugins.options import parse_options
    from vprbench.runs.run_lock import StatusOptions, row, status
    from vprbench.terminal.console import console, show_table

    asked = parse_options(StatusOptions, words, {})
    found = status(asked.results)
    if asked.output == "json":
        print(json.dumps(found))
        return 0
    print(printable("{results}: {runs} runs and {failures} failures are stored".format(**found)))
    if lines := [row(claim) for claim in found["claims"]]:
        show_table([*lines[0]], [[*line.values()] for line in lines], asked.wide or not console().is_terminal)
    else:
        print("no run is being made")
    return 0


def fetch(options: list[str]) -> int:
    """Download a dataset, unpack and check it, or say what a person has to do; without a name list what there is.

    Returns 1 if the frames that came are not right.
    """
    from vprbench.config import make_request
    from vprbench.data.doctor import Finding, quick
    from vprbench.data.fetch.command import fetch_command
    from vprbench.plugins import registry

    wrong: list[Finding] = []

    def check_frames(name: str, root: Path) -> list[str]:
        request = make_request([f"dataset={name}"], {"dataset.root": str(root)})
        found = quick(registry.make_dataset(request.dataset))
        wrong.extend(finding for finding in found if finding.level == "error")
        lines = [f"{finding.level}: {finding.check}: {finding.text}" for finding in found]
        return [*lines, f"python -m vprbench doctor dataset={name} dataset.root={root} looks at every frame"]

    return fetch_command(options, check_frames) or int(bool(wrong))


def table(options: list[str]) -> int:
    """Make the runs that Table II lacks, and write it; figures=true page=true draw its figures and write its page."""
    from vprbench.report.table.make import make_table

    return make_table(*_request_table(options))


def figures(options: list[str]) -> int:
    """Draw the figures of the runs that a results folder holds; nothing is run."""
    from vprbench.plugins.options import parse_options
    from vprbench.report.figures.make import print_figures
    from vprbench.report.folder import read_report
    from vprbench.report.run_options import FolderRequest

    print_figures(read_report(parse_options(FolderRequest, options, {})))
    return 0


def report(options: list[str]) -> int:
    """Write one page on the runs that a results folder holds, with a browser of failures; nothing is run."""
    from vprbench.plugins.options import parse_options
    from vprbench.report.folder import read_report
    from vprbench.report.page.make import print_page
    from vprbench.report.run_options import FolderRequest

    request = parse_options(FolderRequest, options, {})
    print_page(read_report(request), request.name or "report")
    return 0


def search(options: list[str]) -> int:
    """Search the best settings of the method in conf/search.yaml, on places that no result uses."""
    from vprbench.config import make_request
    from vprbench.plugins.options import parse_options
    from vprbench.progress import progress_shown
    from vprbench.runs.store import Store
    from vprbench.tuning import space, text
    from vprbench.tuning.search import search as search_settings
    from vprbench.tuning.settings import QUICK, Settings

    settings = parse_options(Settings, options, QUICK)
    root = {} if settings.root is None else {"dataset.root": settings.root}
    request = make_request([f"method={space.METHOD}", f"dataset={settings.dataset}"], root)
    folder = Path(settings.results).expanduser()
    Store(folder).prepare()
    with progress_shown("search"):
        found = search_settings(settings, request.method, request.dataset)
    print(text.write(found, folder), end="")
    return 0


def print_completion(words: list[str]) -> int:
    """Print a script by which TAB completes commands, names and options: eval "$(vprbench completion bash)"."""
    scripts = {path.name: path for path in Path(__file__).with_name("completion").iterdir()}
    shell = " ".join(words)
    if shell not in scripts:
        raise BadInput(f"completion {shell}: {near(shell, sorted(scripts))}, as in vprbench completion bash")
    print(scripts[shell].read_text(encoding="utf-8"), end="")
    return 0


def _request_table(options: list[str]) -> tuple[TableRequest, list[str]]:
    """Return the rows and columns of a table, and the options of their runs."""
    from vprbench.config import make_request, quote_options
    from vprbench.plugins.options import parse_options
    from vprbench.report.run_options import TableRequest

    own = [option for option in options if TableRequest.has(option)]
    rest = quote_options([option for option in options if option not in own])
    own += quote_options([option for option in own if option.startswith("methods=")])  # loose files get their names
    for option in rest:
        if option.split("=")[0].split(".")[0] in TableRequest.refused:
            raise BadInput(
                f"{option}: rows, methods, columns, seeds and devices say what the table holds; "
                "conf/table.yaml has what they are, and all of it is of clean frames"
            )
    request = parse_options(TableRequest, own, {})
    rest += request.threads(rest)
    run = make_request(rest, {"results": request.results})
    if not request.is_distributed:
        run.require_machine()
    return request, rest


_FOLDER = "vprbench.report.run_options:FolderRequest"

#: By name, in the order of the help.
COMMANDS: dict[str, Command] = {
    "run": Command(run, "vprbench.jobs.options:ClusterOptions", ("method", "dataset", "timing"), None),
    "compare": Command(
        compare, "vprbench.report.run_options:CompareRequest", ("dataset", "timing"), None, usual={"timing": "quick"}
    ),
    "list": Command(show_list, "vprbench.plugins.listing:Listing", words="[methods|datasets] [WORD]"),
    "check": Command(check, groups=("method", "dataset"), run=("device", "threads", "seed")),
    "new": Command(new, "vprbench.plugins.new:Settings", words="method|dataset NAME"),
    "doctor": Command(doctor, groups=("dataset",), run=("output",)),
    "status": Command(show_status, "vprbench.runs.run_lock:StatusOptions"),
    "fetch": Command(fetch, "vprbench.data.fetch.command:Settings", words="[NAME]"),
    "table": Command(table, "vprbench.report.run_options:TableRequest", ("timing",), None),
    "figures": Command(figures, _FOLDER),
    "report": Command(report, _FOLDER),
    "search": Command(search, "vprbench.tuning.settings:Settings"),
    "completion": Command(print_completion, words="bash|zsh|fish"),
}
