"""Whether benchmarks are measured at full size, by `make bench`, or run once and small, as tests."""

import os

FULL = os.environ.get("BENCH") == "full"
