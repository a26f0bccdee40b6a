"""A plan of a table and figures small enough for tests, and its runs made inside the test's own process."""

import contextlib
import io
from dataclasses import replace
from pathlib import Path

import pandas as pd
from PIL import Image
from quick_runs import quick_runs

from vprbench.config import make_request
from vprbench.jobs import executors
from vprbench.jobs.job import make_run
from vprbench.report import gather
from vprbench.report.plan import read_plan
from vprbench.runs.request import RunRequest
from vprbench.runs.timing_lock import share_host

PLAN = """
seeds: [0, 1]
published: {title: Table 9, source: "A paper, Table 9", cpu: Abacus 9, gpu: Loom 3, numbers_file: numbers.csv,
            figures: {training-time: fig2a, query-rate: fig2b, growth: fig2c, similarity: fig3b}}
rows:
  SAD: {method: sad, boundary: match, training: none}
  PCA: {method: pca, boundary: encode, training: pretrained, most_places: 15}
  Nobody: {method: cosplace, boundary: match, training: own}  # its weights are missing
  VPRTempo: {method: vprtempo, boundary: match, training: own, spiking: true, seeds: [0, 1],
             arguments: {height: 12, width: 12, epochs: 1}}
more_rows:
  big_patches: {name: SAD (big patches), method: sad, arguments: {patch: 9}, training: none}
columns:
  nordland: {title: Nordland, published: Nordland, options: [dataset=nordland]}
  route:
    title: Route
    published: Nordland
    stand_in_for: nordland
    options: [dataset=synthetic, dataset.places=20, dataset.first_query_place=4]
  route_12:
    title: Route, 12 places
    stand_in_for: nordland
    options: [dataset=synthetic, dataset.places=12, dataset.first_query_place=2]
growth:
  rows: [SAD]
  options: [dataset=synthetic]
  sizes: [10, 12, 14, 16]
  queries: 6
"""
NUMBERS = "method,dataset,metric,value\nSAD,Nordland,recall_at_1,48\nPCA,Nordland,recall_at_1,\n"
RUN = [*(f"timing.{each}" for each in ("minimum_seconds=0", "sample=4", "minimum_queries=4", "batch_sizes=[1,4]"))]
RUN.append("threads=1")


class Apart:
    """Stands in for processes of their own: makes the run here; remembers the requests."""

    def __init__(self):
        self.asked: list[RunRequest] = []

    def __call__(self, request_json, *_):
        self.asked.append(RunRequest.from_json(request_json))
        printed = []
        with contextlib.redirect_stdout(io.StringIO()), share_host() as lock:
            result = make_run(self.asked[-1], printed.append, lock)
        return replace(result, printed="\n".join(printed))


def run_apart(options):
    """Make the run of these options as a process of its own does."""
    return Apart()(make_request(options).to_json())


def quick_figures(monkeypatch):
    """Let figures be drawn and not rendered, which takes long: their files hold a pixel for each panel."""
    from vprbench.report.figures import style  # brings matplotlib

    def rendered(drawn):
        written = io.BytesIO()
        Image.new("L", (len(drawn.figure.axes), 1)).save(written, "PNG")
        return written.getvalue()

    for kind in ("render_png", "render_pdf"):
        monkeypatch.setattr(style, kind, rendered)


def lines(name):
    """Return the lines of a CSV in the folder of results, each a dictionary of texts."""
    return pd.read_csv(Path("results", name), dtype=str, keep_default_na=False).to_dict("records")


def install(monkeypatch, folder, plan=PLAN):
    """Let tables and figures follow `plan`, in `folder`, of quick runs; returns what stands in for processes."""
    quick_runs(monkeypatch)
    path = folder / "plan.yaml"
    path.write_text(plan, encoding="utf-8")
    (folder / "numbers.csv").write_text(NUMBERS, encoding="utf-8")
    apart = Apart()
    monkeypatch.chdir(folder)
    monkeypatch.setattr(executors, "run_in_child", apart)
    monkeypatch.setattr(gather, "read_plan", lambda _: read_plan(path))
    return apart
