"""The answers of a run as a table: for each query its best places, with the files of their images and their scores."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.runs.record import Run
from vprbench.runs.sequences import format_view_suffix
from vprbench.runs.views import list_shown_queries
from vprbench.storage.atomic import replace_bytes

if TYPE_CHECKING:
    import pandas as pd

    from vprbench.runs.request import RunRequest


def tabulate_predictions(run: Run, n: int, dataset: Dataset | None) -> pd.DataFrame:
    """Return the best `n` places of each query, a row each, best first; of equal scores the lower place comes first.

    `query` is the query's number and `query_image` its file, or its name where it is no file. `rank` begins at 1.
    `place` is the number of the place in the map and `reference_image` the first of its reference images. `right` is
    True or False, None without a ground truth. Without a `dataset` the images are None. Places that are no candidates
    have no row. Raises BadInput below 1, and for more places than the run keeps of a query.
    """
    import pandas as pd  # takes long to import, and a run needs none

    require_depth(n, run.top_places.shape[1], run.outcome.n_places)
    best, scores = run.top_places[:, :n].astype(np.int64), run.top_scores[:, :n]
    right = np.array([np.isin(*row) for row in zip(best, run.positives, strict=True)])
    rows, ranks = np.nonzero(scores > -np.inf)
    queries, places = list_shown_queries(run)[rows], best[rows, ranks]
    shown: tuple[Any, Any] = (None, None)
    if dataset is not None:
        first = np.unique(dataset.places, return_index=True)[1]
        shown = _name_images(dataset.queries, queries), _name_images(dataset.references, first[places])
    return pd.DataFrame(
        {
            "query": queries,
            "query_image": shown[0],
            "rank": ranks + 1,
            "place": places,
            "reference_image": shown[1],
            "score": scores[rows, ranks],
            "right": right[rows, ranks] if run.is_judged else None,
        }
    )


def write_predictions(run: Run, name: str, request: RunRequest, dataset: Dataset) -> list[Path]:
    """Write the best places of each query of a run, or of each of its views, if a request asks for them.

    Returns the files, which lie in the results folder.
    """
    if request.predictions is None:
        return []
    shown = {format_view_suffix([view]): view(run) for view in request.list_views()} or {"": run}
    start = Path(request.results).expanduser() / f"{dataset.name}-{name}"
    return [
        write_csv(tabulate_predictions(one, request.predictions, dataset), Path(f"{start}{ending}-predictions.csv"))
        for ending, one in shown.items()
    ]


def require_depth(n: int, depth: int, n_places: int) -> None:
    """Raise BadInput unless the best `n` places of a query are among the `depth` that a run keeps."""
    if n < 1:
        raise BadInput(f"predictions={n}: give 1 or more places a query")
    if depth < min(n, n_places):
        raise BadInput(f"predictions={n}: a run keeps depth={depth} places a query; give depth={n} too, or fewer")


def write_csv(table: pd.DataFrame, file: Path) -> Path:
    """Write predictions as CSV and return the file; names that are no text are written as the disk has them."""
    replace_bytes(file, table.to_csv(index=False).encode(errors="surrogateescape"))
    return file


def _name_images(images: Images, which: npt.NDArray[np.int64]) -> list[str]:
    """Return the files of some images, or their names where they are no files."""
    called = images.names if images.files is None else images.files
    return [str(called[index]) for index in which.tolist()]
