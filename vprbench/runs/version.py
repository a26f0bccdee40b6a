"""The version of all that reads, scores and times every method alike, which is part of the key of a run."""

from __future__ import annotations

#: Raise it with a change by which a run may have other answers or times; a test holds that nobody forgets to decide.
VERSION = 1

#: The modules whose changes are decided about, beside those of `vprbench.api`.
MODULES = (
    *("vprbench.metrics.ranking", "vprbench.plugins.networks", "vprbench.runs.stopwatch", "vprbench.runs.fitting"),
    *("vprbench.runs.runner", "vprbench.runs.answers", "vprbench.runs.descriptors", "vprbench.runs.machine"),
    *("vprbench.runs.corruption", "vprbench.runs.corrupted_frames"),
)
