"""No test reaches for the internet or for the weights that a person keeps on this machine."""

from __future__ import annotations

import os
import tempfile

os.environ["VPRBENCH_OFFLINE"] = "1"
os.environ["VPRBENCH_WEIGHTS"] = tempfile.mkdtemp(prefix="vprbench-no-weights-")
