"""A report: runs as a table, a ranking, figures, a page, and the files of them."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from vprbench.api.dataset import Dataset
from vprbench.jobs.job import JobResult
from vprbench.metrics.catalogue import METRICS
from vprbench.progress import show_progress
from vprbench.report.plan import Plan
from vprbench.report.ranking import NUMBERS, Ranking, rank_rows
from vprbench.report.robustness import Robustness, format_markdown
from vprbench.report.selection import DatasetRuns, list_method_runs
from vprbench.report.table import formats
from vprbench.report.table.best import average_seeds
from vprbench.report.table.quantities import Quantity
from vprbench.runs import frame
from vprbench.runs.predictions import tabulate_predictions, write_csv
from vprbench.runs.record import Run
from vprbench.runs.rows import describe_sequence
from vprbench.runs.sequences import format_view_suffix
from vprbench.runs.store import Store
from vprbench.storage.atomic import replace_text
from vprbench.text import join_names

if TYPE_CHECKING:
    from vprbench.report.figures.style import Drawing, Figure

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Report:
    """The rows and columns of a plan, the runs behind them, their figures and their page; printed, it is its table."""

    plan: Plan
    groups: tuple[DatasetRuns, ...]  # the columns
    quantities: tuple[Quantity, ...]
    cells: pd.DataFrame  # a line for each row, column and quantity: `table.cells.FACTS` and `TEXTS`
    notes: tuple[str, ...]  # remarks on cells; note n is notes[n - 1]
    machines: tuple[str, ...]  # one line each
    n_aside: int  # stored runs of its rows that it does not show
    runs: tuple[Run, ...] = ()  # all that are stored
    job_results: tuple[JobResult, ...] = ()  # of the runs that were tried now
    robustness: Robustness | None = None  # R@1 under corruptions of the queries
    dataset: Dataset | None = None  # of all columns; names the images of `predictions`

    @cached_property
    def rankings(self) -> list[Ranking]:
        """The rows of each group that has runs, the best first, and the results of tests on them."""
        return [rank_rows(list_method_runs(group, self.plan.rows)) for group in self.groups if group.runs]

    @property
    def ranking(self) -> Ranking:
        """The methods of the first group that has runs, best first, and the sentences of the tests."""
        return self.rankings[0]

    @property
    def sentence(self) -> str:
        """The result of the test of the best method, as a sentence."""
        return self.ranking.sentences[0]

    @property
    def table(self) -> pd.DataFrame:
        """A row for each method, the best first: mean R@1, 0 to 1, its 95 % interval, queries per second, seconds.

        `elsewhere` is R@1 on the places that a method was not tuned on, if it was tuned on others of these. Methods
        without a run stand last; `left_out` is the reason.
        """
        found = self.ranking.table.assign(left_out="").drop(columns="runs")
        for name in self.plan.metrics:
            values = [average_seeds(runs, METRICS[name]) for runs in self.ranking.table["runs"]]
            found.insert([*found].index("hz"), name, values)
        failed = {failure.method: failure for group in self.groups for failure in group.failures}
        absent = [row for row in self.plan.rows if row.name not in {*found["method"]} and row.method in failed]
        lines = [*found.to_dict("records")]
        lines += [{"method": row.name, "seeds": 0, "left_out": failed[row.method].error} for row in absent]
        kinds = {"method": str, **dict.fromkeys([*NUMBERS, *self.plan.metrics], float), "seeds": int, "left_out": str}
        return pd.DataFrame(lines, columns=[*found]).astype(kinds)

    @property
    def drawings(self) -> dict[str, Drawing]:
        """The figures by the names of their files, with captions."""
        return self._drawn[0]

    @property
    def absent(self) -> list[str]:
        """The reason of each figure that is not drawn."""
        return self._drawn[1]

    @cached_property
    def _drawn(self) -> tuple[dict[str, Drawing], list[str]]:
        from vprbench.report.figures.accuracy import draw_robustness
        from vprbench.report.figures.make import draw_all  # matplotlib takes long

        absent: list[str] = []
        with show_progress("figures"):
            found = dict(draw_all(self, absent.append))
        if self.robustness is not None:
            found[f"robustness-{self.groups[0].column.name}"] = draw_robustness(self.robustness)
        return found, absent

    def figures(self) -> dict[str, Figure]:
        """Return all figures by their names."""
        return {name: drawing.figure for name, drawing in self.drawings.items()}

    def predictions(self, n: int | None = None) -> pd.DataFrame:
        """Return the best `n` places of each query by every run that is shown, 10 if None.

        `method`, `seed` and `answers` (the view that is shown, or empty) stand before the columns of `predictions`.
        """
        tables = []
        for group in self.groups:
            for one in list_method_runs(group, self.plan.rows):
                for run in one.runs:
                    found = tabulate_predictions(run, min(n or 10, run.top_places.shape[1]), self.dataset)
                    about = {"method": one.name, "seed": run.config["seed"], "answers": describe_sequence(run)}
                    tables.append(pd.concat([pd.DataFrame(about, index=found.index), found], axis=1))
        return pd.concat(tables, ignore_index=True)

    def write(self, folder: str | Path = "results", name: str = "", predictions: int | None = None) -> list[Path]:
        """Write table (Markdown, CSV, LaTeX), runs, best places, robustness, figures and page into a folder.

        Args:
            folder: made if need be.
            name: of the files; empty: that of the dataset, with the hash of frames and ground truth if files of others
                have it.
            predictions: best places of each query; None: 10, 0: no file.

        Returns:
            The files; of the figures their captions.

        Raises:
            BadInput: the folder cannot be written.
        """
        folder = Path(folder).expanduser()
        name = self._name_files(folder, name)
        files = self.write_table(folder, name)
        if predictions != 0:
            files.append(write_csv(self.predictions(predictions), folder / f"{name}-predictions.csv"))
        if self.robustness is not None:
            points = self.robustness.points.to_csv(index=False, lineterminator="\n")
            for ending, text in (("md", format_markdown(self.robustness, self.plan.heading)), ("csv", points)):
                files.append(folder / f"{name}-robustness.{ending}")
                replace_text(files[-1], text)
        *_, captions = self.write_figures(folder / "figures" / name)
        for path in captions.parent.glob("*.p[dn][fg]"):  # of an earlier comparison of this name
            if path.stem not in self.drawings:
                path.unlink()
        return [*files, captions, self.write_page(folder / f"{name}.html")]

    def write_table(self, folder: Path, name: str) -> list[Path]:
        """Write the table in its three formats, and all numbers of the runs behind it; returns the files."""
        Store(folder).prepare()
        runs = [run for group in self.groups for run in group.runs]
        texts = {
            f"{name}.md": self.to_markdown(),
            f"{name}.csv": formats.to_csv(self),
            f"{name}.tex": self.to_latex(),
            f"{name}-runs.csv": frame.format_csv(runs, self.plan.metrics),
        }
        for file, text in texts.items():
            replace_text(folder / file, text)
        return [folder / file for file in texts]

    def write_figures(self, folder: Path) -> Iterator[Path]:
        """Write the figures as PDF and PNG, and their captions; yields each PDF, then the captions."""
        from vprbench.report.figures.make import write_figures

        return write_figures(self.drawings, folder)

    def write_page(self, path: Path) -> Path:
        """Write the page, one HTML file with the table, the figures and a browser of queries; returns `path`."""
        from vprbench.report.page.make import make_page

        text = make_page(self)
        Store(path.parent).prepare()
        replace_text(path, text)
        return path

    def to_markdown(self) -> str:
        """Return the table in Markdown, with its notes and its legend."""
        return formats.to_markdown(self)

    def to_latex(self) -> str:
        """Return the table in LaTeX; it needs the package booktabs."""
        return formats.to_latex(self)

    def __str__(self) -> str:
        return formats.to_terminal(self, wide=True)

    def _repr_html_(self) -> str:
        sentences = pd.DataFrame({"Findings": self.ranking.sentences})
        return formats.to_html(self) + sentences.to_html(index=False, border=0)

    def _name_files(self, folder: Path, name: str) -> str:
        """Return the name of the files; a warning is logged if an earlier comparison of other methods makes room."""
        column, images = self.plan.columns[0], self.runs[0].fingerprint
        beside_others, name = not name, name or column.title
        name += "-views" * (column.views is not None) + format_view_suffix(self.plan.views)
        if beside_others and not _read_earlier(folder / f"{name}-runs.csv")["fingerprint"].map(images.startswith).all():
            name = f"{name}-{images[:6]}"
        earlier = {*_read_earlier(folder / f"{name}-runs.csv")["method"]}
        if replaced := earlier - {frame.format_label(run) for run in self.runs}:
            methods = join_names(replaced)
            logger.warning("%s: the earlier comparison with %s makes room: name=NAME keeps both", name, methods)
        return name


def _read_earlier(path: Path) -> pd.DataFrame:
    """Return the runs of an earlier comparison whose files have this name; without any no line."""
    return pd.read_csv(path, dtype=str) if path.is_file() else pd.DataFrame(columns=["method", "fingerprint"])
