"""Why a cell of the table has no number, and why a number is not the paper's: each reason has a code and a text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from statistics import mean
from typing import Any, Literal, NamedTuple

from vprbench.metrics.accuracy import recall_at
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.published import PAPER_CPU, PAPER_GPU, PROTOCOLS, PaperProtocol
from vprbench.paper.selection import Device, Group, ResolvedColumn, RowRuns, as_text
from vprbench.paper.table.quantities import Quantity
from vprbench.paper.templates import sentences
from vprbench.runs.notes import DISTURBED, NoteKind
from vprbench.runs.record import Run
from vprbench.text import format_duration

LONGEST = 120  # letters of a reason, beside a command that it gives
_WORDS = r"(?:\[[^\]]*\]|[^][,;()])"
_ADVICE = (  # commands first
    re.compile(rf"`[^`]+`|(?:run )?python -m {_WORDS}+"),
    re.compile(rf"(?<=[:;] )(?:run|set|put|give|get|install|wait|try) {_WORDS}{{1,{LONGEST}}}(?=[,;()]|$)"),
)

Mark = Literal[
    "measured",  # by this harness, on the machine that the cell names
    "quoted",  # copied from a publication: in italics, in no contest
    "not applicable",  # there is no such step: printed as -
    "not there",  # the method, its weights or the frames are missing; the row fills by itself once they are not
    "failed",
    "left out",  # too many places for this row within the time of the table
    "unfinished",  # some of the seeds are not stored yet, or none
    "not timed",  # answers are stored, and no rates with them
    "not run",  # no run of this kind is stored, as on a machine without a GPU
]
#: The word of a cell without a number, by the code of the reason.
MARKS: Mapping[str, Mark] = {
    **{"failed": "failed", "missing": "not there", "left out": "left out"},
    **{"seeds": "unfinished", "untimed": "not timed"},
    **dict.fromkeys(("device", "protocol without runs", "loaded", "kept"), "not run"),
}


class Reason(NamedTuple):
    """What a note below the table says, and what kind of reason it is."""

    code: str  # "failed", "missing", "left out", "paper's way", "tuned", "note", or a macro of reasons.j2
    text: str


def reason(code: str, *values: Any) -> Reason:
    """Return a reason in the words of its template, cut to the length of a note."""
    return short(code, " ".join(sentences("table/sentences.j2", code.replace(" ", "_"), *values)))


def short(code: str, text: str) -> Reason:
    """Return a reason cut to the length of a note."""
    return Reason(code, one_sentence(text, first=False))


def one_sentence(text: str, first: bool = True) -> str:
    """Return a message, or its first sentence, cut between words where it is long, without its full stop.

    What it says to do, such as a command, is kept whole: what stands before is cut in its place.
    """
    whole = " ".join(text.split()).rstrip(" .;")
    line = re.split(r"(?<=[.!?;]) ", whole, maxsplit=1)[0].rstrip(" .;") if first else whole
    advice = next(filter(None, (pattern.search(whole) for pattern in _ADVICE)), None)
    if advice is None or (advice.end() <= len(line) <= LONGEST):
        return _cut(line, LONGEST)
    told = advice[0].rstrip(" .")
    head = _cut(line[: advice.start()].rstrip(), max(LONGEST - len(told) - 1, LONGEST // 2))
    return f"{head}{'…' if advice.start() > len(line) and head[-1:] not in '…' else ''} {told}".lstrip()


def _cut(line: str, longest: int) -> str:
    if len(line) <= longest:
        return line
    cut = line[: longest - 1]
    return (cut[: cut.rfind(" ")] if cut.rfind(" ") > longest // 2 else cut).rstrip(" ,;:") + "…"


# No number


def absent(row: Row, device: Device, found: RowRuns, elsewhere: bool, left_out: str | None) -> Reason:
    """Return why a row without runs on a kind of device has none.

    `elsewhere` tells whether the other kind of device has runs. `left_out` says where rows stand that take too long: on
    the CPU, for of a GPU no more is known than that nothing is stored.
    """
    if found.failures:
        first = next((failure for failure in found.failures if not failure.missing), found.failures[0])
        return Reason("missing" if first.missing else "failed", one_sentence(first.error))
    if left_out is not None and device == "cpu" and not elsewhere:
        return Reason("left out", left_out)
    return reason("device", device) if device == "cuda" or elsewhere else reason("seeds", row, found)


def lacking(quantity: Quantity, runs: Sequence[Run]) -> Reason:
    """Return why none of a row's runs measured a quantity."""
    if quantity.kind == "rate":
        return reason("untimed")
    return reason("loaded" if any(run.network is not None for run in runs) else "kept")


def undefined(quantity: Quantity, runs: Sequence[Run]) -> Reason:
    """Return why runs of a row give no number: why a cost is not known, or that answers leave an accuracy undefined."""
    if quantity.metric is None:
        return Reason("undefined", "no query has a right place")
    told = (run.energy["how"].get(quantity.name) for run in runs if run.energy is not None)
    why = next(filter(None, told), None) if quantity.metric.cost is not None else None
    if why is None:
        return Reason("undefined", "undefined for the answers of this row")
    return short("undefined", f"{quantity.metric.words} n/a: {why}")


# What a reader of a number has to know

_APART: frozenset[NoteKind] = DISTURBED | {"offline", "described", "fitted"}  # told by a mark, or elsewhere


def remarks(quantity: Quantity, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
    """Yield what a reader of a number has to know, from the notes of its runs among others."""
    notes = [note for run in runs for note in run.notes]
    if quantity.kind == "training" and row.training == "map":
        yield reason("map")
    if quantity.kind in ("training", "fit"):
        yield from (short("note", note.text) for note in notes if note.kind == "fitted")
    elif quantity.kind != "memory":  # whose notes stand with the accuracy
        if quantity.fact == "recall_at_1":
            yield from _ties(runs)
        of_rate = quantity.kind == "rate"
        kept = [note for note in notes if note.kind not in _APART and (note.kind == "answers") == of_rate]
        yield from (short("note", note.text) for note in kept)


def _ties(runs: Sequence[Run]) -> Iterator[Reason]:
    """Yield the lowest and highest R@1 if it hangs on ties."""
    recalls = [recall for run in runs if (recall := recall_at(run.outcome, 1)) is not None]
    if any(recall.hangs_on_ties for recall in recalls):
        low, high = (100 * mean(getattr(r, way) for r in recalls) for way in ("pessimistic", "optimistic"))
        yield reason("ties", low, high)


# Another number than the paper's, the weightiest reason first


def differences(
    quantity: Quantity, row: Row, planned: PlannedColumn, real_title: str | None, run: Run
) -> Iterator[Reason]:
    """Yield why a number and the paper's cannot be compared; nothing for a column that the paper lacks.

    `real_title` names the dataset that a rendered one stands in for. `run` is one of the cell's; all of them share what
    is looked at here.
    """
    paper = PROTOCOLS.get(planned.published or "")
    if paper is None:
        return
    if quantity.device is None:
        yield from _of_accuracy(paper, real_title, run)
        return
    yield from _of_times(paper, real_title, run, quantity.device)
    if quantity.kind == "rate" and row.rate_remark is not None:
        yield short("paper's way", row.rate_remark)


def _of_accuracy(paper: PaperProtocol, real_title: str | None, run: Run) -> Iterator[Reason]:
    found = [*_data(real_title, run, paper), *_protocol(run, paper)]
    n_places, n_queries = run.outcome.n_places, len(run.outcome)
    yield from found
    if not found and n_places > n_queries:
        yield reason("distractors", n_places - n_queries)
    elif not found and _leaves_out(run, paper):
        yield reason("no distractors", paper.places - n_places)


def _of_times(paper: PaperProtocol, real_title: str | None, run: Run, device: Device) -> Iterator[Reason]:
    yield from _data(real_title, run, paper)
    if run.outcome.n_places != paper.places:
        yield reason("size", run.outcome.n_places, paper)
    name, theirs = ("processor", PAPER_CPU) if device == "cpu" else ("accelerator", PAPER_GPU)
    ours = str(run.environment.get(name, "an unknown GPU"))
    if theirs.split()[-1] not in ours:
        yield reason("hardware", ours, theirs)


def other_timing(runs: Mapping[str, Sequence[Run]]) -> dict[str, Reason]:
    """Return what to say of the rates of rows that were timed under another protocol than most rows of their column.

    A row of seeds that were timed in several ways is of the way that fewest rows have. Of equally many, the first row's
    counts.
    """
    ways: dict[str, dict[str, Run]] = {}  # by protocol, rows with a run
    for name, run in ((name, run) for name, of_row in runs.items() for run in of_row):
        ways.setdefault(as_text(run.config.get("timing")), {}).setdefault(name, run)
    usual, *others = sorted(ways.values(), key=len, reverse=True) or [{}]
    first = next(iter(usual.values()), None)
    return {
        name: _timed(run, first, [other for other in usual if other != name] or ["its other seeds"])
        for names in others
        for name, run in names.items()
        if first is not None
    }


def _timed(run: Run, usual: Run, rows: Sequence[str]) -> Reason:
    ours, theirs = run.config.get("timing"), usual.config.get("timing") or {}
    return reason("timing", ours, [name for name, value in (ours or {}).items() if value != theirs.get(name)], rows)


def _data(real_title: str | None, run: Run, paper: PaperProtocol) -> Iterator[Reason]:
    if real_title is not None:
        yield reason("rendered", real_title)
        return
    references, query = run.protocol.get("references"), run.protocol.get("query")
    if references is not None and (frozenset(references), query) != (paper.references, paper.query):
        yield reason("traverses", references, query, paper)


def _protocol(run: Run, paper: PaperProtocol) -> Iterator[Reason]:
    places, queries = run.outcome.n_places, len(run.outcome)
    if (places, queries) != (paper.places, paper.queries) and not _leaves_out(run, paper):
        yield reason("counts", queries, places, paper)
    for name, unit in (("tolerance_places", "place"), ("tolerance_metres", "m"), ("radius_metres", "m")):
        if within := run.protocol.get(name):
            yield reason("tolerance", within, unit)


def _leaves_out(run: Run, paper: PaperProtocol) -> bool:
    """Tell whether a run asked the paper's queries of their own places alone."""
    return run.outcome.n_places == len(run.outcome) == paper.queries


_MINUTE = 60.0


def why_left_out(row: Row, column: ResolvedColumn, shown: Sequence[Group]) -> str:
    """Return why a row is left out of a column, and how long its seeds would take there by a run in those `shown`."""
    asking = [group for group in shown if group.column.planned.name == column.planned.name]
    queries = next((len(run.outcome) for run in _runs(asking)), None)
    measured = next((run for run in _runs(shown, row) if run.config["device"] == "cpu" and run.fit_seconds), None)
    places = column.dataset.get("places")
    if measured is None or not isinstance(places, int):
        return "too many places for the time that a table takes; FULL=1 runs it here"
    seconds = full_seconds(measured, places, places if queries is None else queries, row.asks_its_map) * len(row.seeds)
    much = format_duration(max(_MINUTE, seconds))
    seeds = f"; {len(row.seeds)} seeds" if len(row.seeds) > 1 else ""
    return f"FULL=1 would take about {much} here (from its run at {measured.outcome.n_places} places{seeds})"


def full_seconds(measured: Run, places: int, queries: int, asks_its_map: bool) -> float:
    """Return the seconds of one run at so many places and queries, from one that was measured with fewer.

    Training takes as long a place, and asking as long a query and place; `asks_its_map` tells that the fit asks once
    for each of its places, too.
    """
    n_places, n_queries = measured.outcome.n_places, len(measured.outcome)
    fit = measured.fit_seconds or 0.0
    seconds_a_query = max(0.0, measured.method_seconds - (measured.fit_compute_seconds or fit)) / (n_queries * n_places)
    own = places * places * seconds_a_query if asks_its_map else 0.0
    training = fit - n_places * n_places * seconds_a_query if asks_its_map else fit
    return max(0.0, training) * places / n_places + own + places * queries * seconds_a_query


def _runs(shown: Sequence[Group], row: Row | None = None) -> Iterator[Run]:
    for group in shown:
        for run in group.runs:
            if row is None or (run.method == row.method and run.config.get("changed") == row.arguments):
                yield run
