"""The commands beside a run: each takes its options and returns the exit code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vprbench import config
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.plugins.options import chosen
from vprbench.progress import answers_alone, progress_shown
from vprbench.text import printable

if TYPE_CHECKING:
    from vprbench.paper.gather import TableRequest

_NOT_OF_TABLES = ("method", "dataset", "corruption", "seed", "device", "output", "save", "load", "predictions")


def table(options: list[str]) -> int:
    """Make what Table II lacks, and write it."""
    from vprbench.paper.table.make import make_table

    return make_table(*_table_request(options))


def figures(options: list[str]) -> int:
    """Make what the figures lack, and draw them."""
    from vprbench.paper.figures.make import make_figures

    return make_figures(*_table_request(options))


def report(options: list[str]) -> int:
    """Make what the table lacks, and write the page."""
    from vprbench.paper.page.make import make_report

    return make_report(*_table_request(options))


def compare(options: list[str]) -> int:
    """Run methods on one dataset, rank them in a table, draw figures and write a page."""
    from vprbench.comparison.checks import sort_options
    from vprbench.comparison.make import make_comparison

    return make_comparison(sort_options(config.quote_options(options)))


def _table_request(options: list[str]) -> tuple[TableRequest, list[str]]:
    """Return the rows and columns that are asked for, and the options of their runs."""
    from vprbench.paper.gather import TableRequest

    own = [option for option in options if TableRequest.has(option)]
    rest = config.quote_options([option for option in options if option not in own])
    loose = config.quote_options([option for option in own if option.startswith("methods=")])  # files get their names
    own = [*own, *loose]
    for option in rest:
        if option.split("=")[0].split(".")[0] in _NOT_OF_TABLES:
            raise BadInput(
                f"{option}: rows, methods, columns, seeds and devices say what the table holds; "
                "conf/table.yaml has what they are, and all of it is of clean frames"
            )
    request = chosen(TableRequest, own, {})
    rest += request.threads(rest)
    run = config.make_request(rest, {"results": request.results})
    if not request.is_distributed:
        run.require_machine()
    return request, rest


def search_parameters(options: list[str]) -> int:
    """Search the best settings of the method in conf/search.yaml, on places that no result uses."""
    from vprbench.runs.store import Store
    from vprbench.tuning import search, space, text

    settings = chosen(search.Settings, options, search.QUICK)
    root = {} if settings.root is None else {"dataset.root": settings.root}
    request = config.make_request([f"method={space.METHOD}", f"dataset={settings.dataset}"], root)
    folder = Path(settings.results).expanduser()
    Store(folder).prepare()
    with progress_shown("search"):
        found = search.search(settings, request.method, request.dataset)
    print(text.write(found, folder), end="")
    return 0


def check(options: list[str]) -> int:
    """Test a method or dataset against the rules of the contract and count them.

    Raises BadInput if none is named.
    """
    from vprbench.plugins import conformance
    from vprbench.runs import machine

    groups = [group for group in ("method", "dataset") if any(option.startswith(f"{group}=") for option in options)]
    if len(groups) != 1:
        raise BadInput(f"check needs method=NAME or dataset=NAME; {registry.near('', registry.entries('method'))}")
    request = config.make_request(options)
    request.require_machine()
    machine.pin_threads(request.n_threads)
    given = {option.split("=")[0].removeprefix("method.") for option in options}
    with progress_shown(request.method_name if groups == ["method"] else request.dataset_name):  # of a download
        if groups == ["method"]:
            results = list(conformance.check({**request.method, "tuned_on": request.tuned_on or None}, given))
        else:
            results = list(conformance.check_dataset(request.dataset))
    for result in results:
        print(printable(str(result)))
    kept, excepted, broken = (sum(r.state == state for r in results) for state in ("kept", "excepted", "broken"))
    print(f"{len(results)} rules: {kept} kept, {excepted} excepted, {broken} broken")
    return 1 if broken else 0


def new(options: list[str]) -> int:
    """Write the files of a new method or dataset, which keep the contract at once: new method NAME."""
    from vprbench.plugins.new import new as written

    print(printable(written(options), but="\n"))
    return 0


def doctor(options: list[str]) -> int:
    """Examine a dataset and say what is wrong with it and what to do.

    Raises BadInput if no dataset is named, and for options that are neither its own nor output=json.
    """
    from vprbench.data.doctor import command

    if not any(option.startswith("dataset=") for option in options):
        raise BadInput(f"doctor needs dataset=NAME; {registry.near('', registry.entries('dataset'))}")
    for option in options:
        if option.partition("=")[0].split(".")[0] not in ("dataset", "output"):
            raise BadInput(f"{option} is no option of doctor: it takes dataset=, dataset.OPTION= and output=json")
    request = config.make_request(options)
    with progress_shown(f"doctor, {request.dataset_name}"), answers_alone() as say:
        return command(
            request.dataset_name,
            lambda: registry.make_dataset(request.dataset),
            lambda text: say(printable(text, but="\n")),
            "json" if request.output == "json" else "text",
        )


def fetch(options: list[str]) -> int:
    """Download a dataset, unpack and check it, or say what a person has to do; without a name list what there is.

    Returns 1 if the frames that came are not right.
    """
    from vprbench.data.doctor import Finding, quick
    from vprbench.data.fetch.command import fetch_command

    def check(name: str, root: Path) -> list[str]:
        request = config.make_request([f"dataset={name}"], {"dataset.root": str(root)})
        found = quick(registry.make_dataset(request.dataset))
        wrong.extend(finding for finding in found if finding.level == "error")
        lines = [f"{finding.level}: {finding.check}: {finding.text}" for finding in found]
        return [*lines, f"python -m vprbench doctor dataset={name} dataset.root={root} looks at every frame"]

    wrong: list[Finding] = []
    return fetch_command(options, check) or int(bool(wrong))
