"""How far the answers of two devices lie apart."""

from dataclasses import dataclass

import numpy as np

TOLERANCE = 1e-4  # of the largest number


@dataclass(frozen=True)
class Agreement:
    """The difference of two methods, or of two ways to ask one."""

    difference: float  # the largest, as a share of the largest number of its array or of its query's scores
    other_places: int  # queries whose best place here is not among the best there, but for the tolerance
    queries: int

    @property
    def holds(self):
        """Whether both are the same but for rounding; a difference that is no number is none."""
        return self.difference <= TOLERANCE and self.other_places == 0

    def columns(self):
        """Return the difference in words, as columns of a report."""
        return {"difference": f"{self.difference:.1e}", "other best places": f"{self.other_places} of {self.queries}"}


def compare_networks(here, there, queries):
    """Compare what two networks learnt, and which places are best for their queries."""
    ours, theirs = here.state(), there.state()
    assert ours.keys() == theirs.keys()
    return _agree([(ours[name], theirs[name]) for name in theirs], here.query(queries), there.query(queries))


def compare_descriptors(here, there, queries):
    """Compare the descriptors of two methods, and which places are best for their queries."""
    return _agree([(here.encode(queries), there.encode(queries))], here.query(queries), there.query(queries))


def compare_scores(here, there):
    """Compare two arrays of scores, (n_queries, n_places)."""
    return _agree(zip(here, there, strict=True), here, there)


def _agree(pairs, here, there):
    """Return the agreement of pairs of arrays; a place is another one if its score there is below the best there."""
    difference = np.max([np.abs(ours - theirs).max() / (np.abs(theirs).max() or 1.0) for ours, theirs in pairs])
    named = np.take_along_axis(there, here.argmax(1)[:, None], axis=1)
    enough = there.max(1, keepdims=True) - TOLERANCE * np.abs(there).max(1, keepdims=True)
    return Agreement(float(difference), int((~(named >= enough)).sum()), len(here))
