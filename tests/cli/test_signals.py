"""A command that is interrupted, however early, ends with one line and the exit code of the signal."""

import signal
import subprocess
import sys

import pytest
from checkout import ROOT

PROGRAM = """
import os, runpy, sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            exec("os.kill(os.getpid(), {number})")  # as named tuples and dataclasses run code

sys.meta_path.insert(0, Interrupting())
sys.argv[0] = "vprbench"
runpy.run_module("vprbench", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("module", ["vprbench.errors", "torch"])
def test_a_signal_while_modules_are_imported_ends_the_command_in_one_line(module, number, tmp_path):
    code = PROGRAM.format(module=module, number=int(number))
    command = [sys.executable, "-c", code, "method=sad", f"results={tmp_path}", "dataset.places=12"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert [line[:21] for line in done.stderr.splitlines()] == ["vprbench: interrupted"]
