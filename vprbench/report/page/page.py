"""The report: one HTML page that holds everything it shows and asks no network for anything."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from vprbench.report.page.columns import format_place_ranges, list_columns, list_places_shown
from vprbench.report.ranking import rank_rows
from vprbench.report.selection import MethodRuns
from vprbench.report.table.quantities import TRAINING_TIME
from vprbench.runs.machine import Machine, format_versions
from vprbench.runs.query_results import RIGHT, UNANSWERABLE, UNJUDGED, Answers, judge_answers, order_by_interest
from vprbench.runs.recall_intervals import METHOD
from vprbench.runs.record import Run
from vprbench.runs.rows import describe_protocol
from vprbench.runs.thumbnails import Thumbnails, choose_frames
from vprbench.runs.tuned import list_notes
from vprbench.text import format_count

TITLE = "Visual place recognition, measured"
MOST_FRAMES = 6000  # of a page, about 1.3 kB each

_FOLDER = Path(__file__).parent
_FINDINGS = 3  # sentences

Facts = list[tuple[str, str]]  # (term, text)
_NO_FRAMES = "The frames of this dataset are not stored, so names stand in their places."
_SOME_FRAMES = "{:,} of {:,} frames are shown; names stand in the places of the others."


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class Section:
    """The runs of one dataset and protocol, with its frames if they are stored."""

    title: str
    series: tuple[MethodRuns, ...]
    thumbnails: Thumbnails | None

    @property
    def runs(self) -> dict[str, Run]:
        """The runs of all rows and seeds, by the names that the page has for them."""
        return {name_run(series, run): run for series in self.series for run in series.runs}

    @cached_property
    def answers(self) -> dict[str, Answers]:
        """The judged answers of each run; raises ValueError for runs of several datasets."""
        if len({run.fingerprint for run in self.runs.values()}) > 1:
            raise ValueError(f"the runs of {self.title} are of different images: a section shows one dataset")
        return {name: judge_answers(run) for name, run in self.runs.items()}


def render_page(
    table_html: str,
    pictures: Sequence[Picture],
    sections: Sequence[Section],
    title: str = TITLE,
    made_from: str = "",
    measured: Sequence[tuple[str, MethodRuns]] = (),
    absent: Sequence[str] = (),
) -> str:
    """Return the page: findings, queries one by one, table, figures, protocol, machines and notes.

    Args:
        table_html: a fragment that is escaped already.
        pictures: the figures.
        sections: the runs of each dataset. At most `MOST_FRAMES` frames are shown, as many of each section: those of
            the queries that the page opens with, of further wrong answers, then of right ones.
        title: of the page.
        made_from: a sentence below the title.
        measured: the series behind the table on every device, with the titles of their sections, for machines and
            notes; those of the sections if there are none.
        absent: the reason of each figure that is not drawn.

    Raises:
        ValueError: the runs of a section are of different images.
    """
    measured = measured or [(section.title, series) for section in sections for series in section.series]
    sections = [section for section in sections if section.series]
    frames = [_choose_frames(section, MOST_FRAMES // len(sections)) for section in sections]
    judged = any(run.is_judged for section in sections for run in section.runs.values())
    fact_lists = [
        ("protocol", "Protocol", [(one.title, describe_protocol(one.series[0].runs[0])) for one in sections]),
        ("machines", "Machines", list_machines(series for _, series in measured)),
        ("notes", "Notes of the runs", list_run_notes(measured)),
    ]
    fact_lists = [(id, heading, facts) for id, heading, facts in fact_lists if facts]
    browsing = [("findings", "Findings"), ("browser", "Failures" if judged else "Queries")] if sections else []
    fixed = [("table", "Table"), ("figures", "Figures"), ("terms", "Terms")]
    style, script = ((_FOLDER / name).read_text(encoding="utf-8") for name in ("style.css", "report.js"))
    templates = Environment(
        loader=FileSystemLoader(_FOLDER), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    text = templates.get_template("template.html").render(
        title=title,
        made_from=made_from,
        parts=[*browsing, *fixed, *(each[:2] for each in fact_lists)],
        table=Markup(table_html),
        pictures=[{"name": one.name, "caption": one.caption, "png": _base64(one.png)} for one in pictures],
        absent=absent,
        sections=[
            {"title": one.title, "findings": list_findings(one.series, one.answers.values())} for one in sections
        ],
        interval_method=METHOD,
        training_time=TRAINING_TIME,
        fact_lists=fact_lists,
        judged=judged,
        style=Markup(style),
        script=Markup(script),
        style_hash=_hash(style),
        script_hash=_hash(script),
        answers=_json([_list_answers(*shown) for shown in zip(sections, frames, strict=True)]),
        frames=[_json(one) for one in frames],
    )
    return text.encode("utf-8", "replace").decode()  # a file name may hold what is no text


def _choose_frames(section: Section, most: int) -> dict[str, Any]:
    """Return the frames of a section that the page shows, `most` at most, as WebP in base64.

    `queries` holds one of each query, empty if it is not shown, and none where no frames are stored; `places` holds
    those of places by their number.
    """
    kept = section.thumbnails
    if kept is None:
        return {"queries": [], "places": {}}
    in_turn = zip(*map(order_by_interest, section.answers.values()), strict=True)  # of each run a query
    queries, places = choose_frames(chain.from_iterable(in_turn), most)
    n_queries = len(section.series[0].runs[0].outcome)
    return {
        "queries": [_base64(kept.queries[query]) if query in queries else "" for query in range(n_queries)],
        "places": {place: _base64(frame) for place in sorted(places) if (frame := kept.references[place])},
    }


def _list_answers(section: Section, frames: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a section that the page's script reads."""
    kept, places = section.thumbnails, list_places_shown(section.answers.values())
    run = section.series[0].runs[0]
    place_names = None if kept is None else {place: kept.reference_names[place] for place in places}
    n_shown, n_wanted = sum(map(bool, frames["queries"])) + len(frames["places"]), len(run.outcome) + len(places)
    missing = _NO_FRAMES if kept is None else _SOME_FRAMES.format(n_shown, n_wanted)
    return {
        "title": section.title,
        "judged": run.is_judged,
        "nPlaces": run.outcome.n_places,
        "nQueries": len(run.outcome),
        "queryNames": kept and kept.query_names,
        "placeNames": place_names,
        "rightPlaces": [format_place_ranges(right) for right in run.positives],
        "framesMissing": "" if n_shown == n_wanted else missing,
        "runs": [{"name": name, **list_columns(one)} for name, one in section.answers.items()],
    }


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _json(content: Any) -> Markup:
    """Return plain values as JSON that cannot end the script element around it."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def _hash(text: str) -> str:
    """Return the name of a script or a style in a content security policy."""
    return f"sha256-{_base64(hashlib.sha256(text.encode()).digest())}"


def list_findings(series: Sequence[MethodRuns], answers: Iterable[Answers]) -> list[str]:
    """Return at most three sentences on the rows of one dataset: results of tests, then counts of missed queries.

    `answers` are those of their runs.
    """
    found = list(rank_rows(series).sentences)
    kinds = [set(verdicts) for verdicts in zip(*(one.verdicts for one in answers), strict=True)]
    wrong = [RIGHT not in kind for kind in kinds if kind not in ({UNANSWERABLE}, {UNJUDGED})]
    n_runs = sum(len(one.runs) for one in series)
    if n_runs > 1 and wrong:
        by_some = sum(RIGHT in kind and len(kind) > 1 for kind in kinds)
        missed = f"all {n_runs} runs miss {sum(wrong):,}, some runs miss {by_some:,} more"
        found.append(f"Of {format_count(len(wrong), 'query')} {missed}.")
    return found[:_FINDINGS]


def list_machines(series: Iterable[MethodRuns]) -> Facts:
    """Return each machine with its versions, and on a line of its own the runs made there, in the order of the runs."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for one in series:
        for run in one.runs:
            made_on = Machine.of(run.environment).line, format_versions(run.environment)
            found.setdefault(made_on, {})[f"{one.name} ({run.dataset})"] = None
    return [(machine, f"{versions}\n{', '.join(runs)}") for (machine, versions), runs in found.items()]


def list_run_notes(measured: Iterable[tuple[str, MethodRuns]]) -> Facts:
    """Return the notes of runs, each after the run's name; `measured` is rows with the titles of their datasets."""
    facts = []
    for title, one in measured:
        for run in one.runs:
            device = "" if run.config.get("device") in (None, "cpu") else f", on {run.config['device']}"
            facts += [(f"{title}: {name_run(one, run)}{device}", note.text) for note in list_notes(run)]
    return facts


def name_run(series: MethodRuns, run: Run) -> str:
    """Return the name of a run within its dataset: that of its row, and its seed if the row has several."""
    return f"{series.name}, seed {run.config['seed']}" if len(series.runs) > 1 else series.name
