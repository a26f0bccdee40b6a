"""The commands: one function each, which takes options, imports what is large, and returns the exit code."""

from __future__ import annotations

import json
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from vprbench.errors import BadInput
from vprbench.plugins.options import parse_options
from vprbench.progress import show_progress
from vprbench.terminal.console import format_table, make_console
from vprbench.terminal.streams import results_only_on_stdout
from vprbench.text import escape_unprintable, suggest_names

if TYPE_CHECKING:
    from vprbench.report.run_options import TableRequest

ALL = "*"  # every option of a run that the class of a command does not refuse


@dataclass(frozen=True)
class Command:
    """A command and its options."""

    call: Callable[[list[str]], int]  # its docstring says in the first sentence what it does
    options: str = ""  # module:Class, whose fields are its options
    takes: tuple[str, ...] = ()  # options of a run; method, dataset and timing bring those of their yaml with them
    words: str = ""  # before the options: NAME

    @property
    def meaning(self) -> str:
        """What it does, in a sentence."""
        return (self.call.__doc__ or "").partition("\n")[0].removesuffix(".")

    def option_class(self) -> type | None:
        """Import and return the class whose fields are its options; None if it has none of its own."""
        return cast(type, pkgutil.resolve_name(self.options)) if self.options else None


def run(options: list[str]) -> int:
    """Run one method on one dataset, or with -m all combinations, each in a process of its own.

    With `--cfg job` the configuration of the run is printed, and nothing runs.
    """
    from vprbench.config import make_request, show_config, split_sweep
    from vprbench.jobs.child import run_in_child
    from vprbench.jobs.job import make_run
    from vprbench.jobs.options import ClusterOptions
    from vprbench.jobs.sweep import run_sweep
    from vprbench.runs.store import Store

    if "--cfg" in options:
        print(show_config([option for option in options if option not in ("--cfg", "job")]), end="")
        return 0
    own = [option for option in options if ClusterOptions.has(option)]
    of_runs = [option for option in options if option not in ("-m", *own)]
    if "-m" in options and of_runs:
        cluster = parse_options(ClusterOptions, own)
        runs = split_sweep([*of_runs, *cluster.threads(of_runs)])
        requests = [make_request(run) for run in runs]
        code, keys = run_sweep(requests, cluster)
        if len(keys) > 1 and requests[0].output == "row":
            from vprbench.report.folder import print_sweep

            print_sweep(keys, requests[0])
        return code
    if len(of_runs) < len(options):
        raise BadInput(f"{' '.join(options)}: several runs need -m and their options, as in -m method=sad,pca")
    request = make_request(of_runs)
    store = Store(Path(request.results).expanduser().absolute())  # a method may change the working folder
    with results_only_on_stdout() as say:
        result = make_run(request, say) if request.limit_minutes is None else run_in_child(request.to_json())
        if result.printed:
            say(result.printed)
        if result.failure is not None and result.code == 1:
            store.try_to_save_failure(result.failure)
    return result.code


def compare(options: list[str]) -> int:
    """Run methods on one dataset, rank them in a table, draw figures and write a page."""
    from vprbench.config import quote_options
    from vprbench.report.comparison import make_comparison

    return make_comparison(quote_options(options))


def show_list(words: list[str]) -> int:
    """Show the methods and datasets, or those that fit: list spiking, list weights=none, list datasets."""
    from vprbench.plugins.entries import list_broken_plugins
    from vprbench.plugins.listing import Listing, format_summary, list_entries

    settings = parse_options(Listing, [word for word in words if "=" in word])
    found = list_entries([word for word in words if "=" not in word], settings.weights)
    if settings.output == "json":
        print(json.dumps(found))
        return 0
    for group in ("method", "dataset"):
        if rows := [(each["name"], format_summary(each)) for each in found if each["kind"] == group]:
            print(format_table([f"{group}s", ""], rows, settings.wide or not make_console().is_terminal))
    for provider, reason in list_broken_plugins() if not words else ():
        print(escape_unprintable(f"plug-in {provider} BROKEN: {reason}"))
    return 0


def check(options: list[str]) -> int:
    """Test a method or dataset against the rules of the contract and count them."""
    from vprbench.config import make_request
    from vprbench.plugins import conformance
    from vprbench.runs import machine

    names = {option.partition("=")[0] for option in options}
    if len(names & {"method", "dataset"}) != 1:
        raise BadInput("check needs method=NAME or dataset=NAME: vprbench list shows the names")
    request = make_request(options)
    request.require_machine()
    machine.pin_threads(request.n_threads)
    with show_progress("check"):  # of a download
        if "dataset" in names:
            results = [*conformance.check_dataset(request.dataset)]
        else:
            given = {name.removeprefix("method.") for name in names}
            results = [*conformance.check_method({**request.method, "tuned_on": request.tuned_on or None}, given)]
    for result in results:
        print(escape_unprintable(str(result)))
    kept, excepted, broken = (sum(r.state == state for r in results) for state in ("kept", "excepted", "broken"))
    print(f"{len(results)} rules: {kept} kept, {excepted} excepted, {broken} broken")
    return int(broken > 0)


def new(options: list[str]) -> int:
    """Write the files of a new method or dataset, which keep the contract at once: new method NAME."""
    from vprbench.plugins.new import write_plugin

    print(escape_unprintable(write_plugin(options), but="\n"))
    return 0


def doctor(options: list[str]) -> int:
    """Examine a dataset and say what is wrong with it and what to do."""
    from vprbench.config import make_request
    from vprbench.data.doctor import command
    from vprbench.plugins.registry import make_dataset

    names = {option.partition("=")[0] for option in options}
    if "dataset" not in names or any(name.partition(".")[0] not in ("dataset", "output") for name in names):
        raise BadInput(f"doctor {' '.join(options)}: it takes dataset=NAME, dataset.OPTION= and output=json alone")
    request = make_request(options)
    name = request.dataset_name
    with show_progress(f"doctor, {name}"), results_only_on_stdout() as say:
        return command(
            name,
            lambda: make_dataset(request.dataset),
            lambda text: say(escape_unprintable(text, but="\n")),
            "json" if request.output == "json" else "text",
        )


def show_status(words: list[str]) -> int:
    """Show which runs of a results folder are made now and by whom, and how many are stored."""
    from vprbench.runs.status import StatusOptions, format_row, read_status

    settings = parse_options(StatusOptions, words)
    found = read_status(settings.results)
    if settings.output == "json":
        print(json.dumps(found))
        return 0
    print(escape_unprintable("{results}: {runs} runs and {failures} failures are stored".format(**found)))
    lines = [format_row(claim) for claim in found["claims"]]
    rows = [[*line.values()] for line in lines]
    is_wide = settings.wide or not make_console().is_terminal
    print(format_table([*lines[0]], rows, is_wide) if lines else "no run is being made")
    return 0


def fetch(options: list[str]) -> int:
    """Download a dataset, unpack and check it, or say what a person has to do; without a name list what there is.

    Returns 1 if the frames that came are not right.
    """
    from vprbench.config import make_request
    from vprbench.data.doctor import quick
    from vprbench.data.fetch import fetch_command
    from vprbench.plugins.registry import make_dataset

    levels = list[str]()

    def check_frames(name: str, root: Path) -> list[str]:
        found = quick(make_dataset(make_request([f"dataset={name}"], {"dataset.root": str(root)}).dataset))
        levels.extend(finding.level for finding in found)
        lines = [f"{finding.level}: {finding.check}: {finding.text}" for finding in found]
        return [*lines, f"python -m vprbench doctor dataset={name} dataset.root={root} looks at every frame"]

    return fetch_command(options, check_frames) or int("error" in levels)


def table(options: list[str]) -> int:
    """Make the runs that Table II lacks, and write it; figures=true page=true draw its figures and write its page."""
    from vprbench.report.table.make import make_table

    return make_table(*_parse_table(options))


def _parse_table(options: list[str]) -> tuple[TableRequest, list[str]]:
    """Return the rows and columns of a table, and the options of their runs."""
    from vprbench.config import make_request, quote_options
    from vprbench.report.run_options import TableRequest

    own = [option for option in options if TableRequest.has(option)]
    of_runs = quote_options([option for option in options if option not in own])
    for option in of_runs:
        if option.split("=")[0].split(".")[0] in TableRequest.refused:
            wanted = "rows=, methods=, columns=, seeds= and devices= say what the table of clean frames holds"
            raise BadInput(f"{option}: {wanted}")
    own += quote_options([option for option in own if option.startswith("methods=")])  # loose files get their names
    request = parse_options(TableRequest, own)
    of_runs += request.threads(of_runs)
    run = make_request(of_runs, {"results": request.results})
    if not request.is_distributed:
        run.require_machine()
    return request, of_runs


def figures(options: list[str]) -> int:
    """Draw the figures of the runs that a results folder holds; nothing is run."""
    from vprbench.report.folder import read_report
    from vprbench.report.missing_runs import resolve_results_folder
    from vprbench.report.run_options import FolderRequest

    request = parse_options(FolderRequest, options)
    folder = resolve_results_folder(request.results) / "figures"
    print("written to", *read_report(request).write_figures(folder), sep="\n  ")
    return 0


def report(options: list[str]) -> int:
    """Write one page on the runs that a results folder holds, with a browser of failures; nothing is run."""
    from vprbench.report.folder import read_report
    from vprbench.report.missing_runs import resolve_results_folder
    from vprbench.report.run_options import FolderRequest

    request = parse_options(FolderRequest, options)
    path = resolve_results_folder(request.results) / f"{request.name or 'report'}.html"
    print(f"written to {read_report(request).write_page(path)}")
    return 0


def search(options: list[str]) -> int:
    """Search the best settings of the method in conf/search.yaml, on places that no result uses."""
    from vprbench.config import make_request
    from vprbench.runs.store import Store
    from vprbench.tuning import space, text
    from vprbench.tuning.search import search as search_settings
    from vprbench.tuning.settings import Settings

    settings = parse_options(Settings, options)
    root = {} if settings.root is None else {"dataset.root": settings.root}
    request = make_request([f"method={space.METHOD}", f"dataset={settings.dataset}"], root)
    folder = Path(settings.results).expanduser()
    Store(folder).prepare()
    with show_progress("search"):
        found = search_settings(settings, request.method, request.dataset)
    print(text.write_report(found, folder), end="")
    return 0


def print_completion(words: list[str]) -> int:
    """Print a script by which TAB completes commands, names and options: eval "$(vprbench completion bash)"."""
    scripts = {path.name: path for path in Path(__file__).with_name("completion").iterdir()}
    shell = " ".join(words)
    if shell not in scripts:
        raise BadInput(f"completion {shell}: {suggest_names(shell, sorted(scripts))}, as in vprbench completion bash")
    print(scripts[shell].read_text(encoding="utf-8"), end="")
    return 0


_FOLDER = "vprbench.report.run_options:FolderRequest"

#: By name, in the order of the help.
COMMANDS: dict[str, Command] = {
    "run": Command(run, "vprbench.jobs.options:ClusterOptions", ("method", "dataset", "timing", ALL)),
    "compare": Command(compare, "vprbench.report.run_options:CompareRequest", ("dataset", "timing", ALL)),
    "list": Command(show_list, "vprbench.plugins.listing:Listing", words="[methods|datasets] [WORD]"),
    "check": Command(check, takes=("method", "dataset", "device", "threads", "seed")),
    "new": Command(new, "vprbench.plugins.new:Settings", words="method|dataset NAME"),
    "doctor": Command(doctor, takes=("dataset", "output")),
    "status": Command(show_status, "vprbench.runs.status:StatusOptions"),
    "fetch": Command(fetch, "vprbench.data.fetch:Settings", words="[NAME]"),
    "table": Command(table, "vprbench.report.run_options:TableRequest", ("timing", ALL)),
    "figures": Command(figures, _FOLDER),
    "report": Command(report, _FOLDER),
    "search": Command(search, "vprbench.tuning.settings:Settings"),
    "completion": Command(print_completion, words="bash|zsh|fish"),
}
