"""A disk that takes no file beyond a length, as far as this process is concerned."""

from contextlib import contextmanager

import pytest


@contextmanager
def no_file_may_exceed(limit_bytes):
    """Let the system refuse longer files within the block; the test is skipped if the system knows no limits."""
    resource = pytest.importorskip("resource", reason="limits on open files are of Unix alone")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
