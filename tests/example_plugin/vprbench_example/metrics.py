"""A metric: the mean reciprocal rank."""

import numpy as np

from vprbench.metrics.catalogue import average_metric


def invert_ranks(run, ties):
    """Return 1 / rank of the best right place of each query, (n_queries,); 0 for a query without any."""
    outcome = run.outcome
    behind = 0 if ties == "optimistic" else outcome.tied - outcome.tied_correct
    return np.where(outcome.tied > 0, 1 / (1 + outcome.above + behind), 0.0)


MRR = average_metric("mrr", "MRR", invert_ranks, "the mean of 1 / rank of the best right place", digits=3, unit="")
