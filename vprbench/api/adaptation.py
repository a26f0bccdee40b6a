"""Codes adapted to the condition that they are seen in: the mean code of the condition is taken off each of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from vprbench.errors import NotFittedError

if TYPE_CHECKING:
    from vprbench.api.method import Method

#: Which mean is taken off a query's code; the references' own mean is taken off the references.
Adapt = Literal["none", "references", "running", "traverse"]

_PSEUDO_QUERIES = 20  # that the references' mean counts for in a running mean
_TOGETHER = 64  # queries whose means are held at once

Codes = npt.NDArray[np.float32]  # (n_queries, n_dimensions), or (n_queries, n_views, n_dimensions)


class Adaptation:
    """Adapts the codes of one traverse of queries, in their order, as the method's `adapt` says.

    `references` takes the references' mean off each query. `running` takes off the mean of the queries so far, the
    query itself included, where the references' mean counts as 20 more queries: a robot that drives can do so.
    `traverse` takes off the mean of all queries, which are known before the first answer only offline. Under `none`
    codes stay as they are. Ground truth has no part in it.

    Source: Schubert, Neubert and Protzel, "Unsupervised learning methods for visual place recognition in discretely and
    continuously changing environments" (ICRA 2020), who standardise descriptors by condition. Division by the spread of
    each dimension lost on held-out places (results/efficientnet.md), so the mean alone is taken off.
    """

    def __init__(self, method: Method) -> None:
        """Begin a traverse."""
        self._method = method
        self._sum: npt.NDArray[np.float64] | None = None  # (n_dimensions,), of the queries so far
        self._n_queries = 0

    @property
    def is_causal(self) -> bool:
        """Whether no query has to be known before another one is answered."""
        return bool(self._method.adapt != "traverse")

    def survey(self, codes: Codes) -> None:
        """Take note of the codes of further queries, whose mean `traverse` takes off."""
        total = _query_codes(codes).sum(0, dtype=np.float64)
        self._sum = total if self._sum is None else self._sum + total
        self._n_queries += len(codes)

    def apply(self, codes: Codes) -> Codes:
        """Return the adapted codes of the next queries; raises NotFittedError before `fit`.

        The views of a query share one mean, to which they count as one query.
        """
        if self._method.adapt == "none":
            return codes
        known = self._method.reference_mean
        if known is None:
            name = type(self._method).__name__
            raise NotFittedError(f"{name} knows no mean of its references: call fit, which has to call fit_encoded")
        if self._method.adapt == "running":
            parts = [self._apply_running(codes[at : at + _TOGETHER], known) for at in range(0, len(codes), _TOGETHER)]
            return np.concatenate(parts) if parts else self._method.centre(codes, known)
        if self._method.adapt == "traverse" and self._sum is not None and self._n_queries:
            known = np.asarray(self._sum / self._n_queries, np.float32)
        return self._method.centre(codes, known)

    def _apply_running(self, codes: Codes, known: npt.NDArray[np.float32]) -> Codes:
        before = np.zeros(len(known)) if self._sum is None else self._sum
        sums = np.cumsum(np.concatenate([before[None], _query_codes(codes)]), axis=0)[1:]  # in float64, one by one
        counts = self._n_queries + np.arange(1, len(codes) + 1)
        means = (sums + _PSEUDO_QUERIES * known.astype(np.float64)) / (counts + _PSEUDO_QUERIES)[:, None]
        self._sum, self._n_queries = sums[-1], self._n_queries + len(codes)
        of_views = means if codes.ndim == 2 else means[:, None]
        return self._method.centre(codes, of_views.astype(np.float32))


def adapt_traverse(method: Method, codes: Codes) -> Codes:
    """Return the adapted codes of all queries of a traverse, in their order."""
    adaptation = Adaptation(method)
    if not adaptation.is_causal:
        adaptation.survey(codes)
    return adaptation.apply(codes)


def _query_codes(codes: Codes) -> Codes:
    """Return one code a query, the mean of its views."""
    return codes if codes.ndim == 2 else codes.mean(1)
