"""The version of all that reads, scores and times every method alike, which is part of the key of a run."""

from __future__ import annotations

#: Raise it with a change by which a run may have other answers or times; a test holds that nobody forgets to decide.
VERSION = 1

#: The modules whose changes are decided about.
MODULES = (
    *("vprbench.api.images", "vprbench.api.decoding", "vprbench.api.read_ahead", "vprbench.api.image_formats"),
    "vprbench.api.png",
    *("vprbench.metrics.ranking", "vprbench.plugins.networks", "vprbench.run.stopwatch", "vprbench.run.fitting"),
    *("vprbench.run.runner", "vprbench.run.answers", "vprbench.run.descriptors", "vprbench.run.machine"),
    *("vprbench.run.corruption", "vprbench.run.corrupted_frames"),
)
