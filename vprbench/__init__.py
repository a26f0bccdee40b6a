"""A benchmark for Visual Place Recognition: which method is better, how fast it is, and how sure that is."""

from pathlib import Path

__version__ = "0.6.1"

# In a bare checkout `methods/`, `datasets/` and `conf/` stand beside this package instead of inside it;
# a wheel maps them to vprbench.methods, vprbench.datasets and vprbench.conf.
_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "pyproject.toml").is_file() and (_checkout / "conf").is_dir():
    __path__.append(str(_checkout))
