"""Plug-ins of methods installed for a test, for the processes that it starts too."""

import os
from functools import cache

from checkout import ROOT

from vprbench.plugins import entries


def plugin(root, package, point, methods):
    """Install a package under the name of an entry point, with the yamls of these methods but for their first line."""
    folder = root / f"{package}_conf" / "method"
    folder.mkdir(parents=True)
    for name, text in methods.items():
        (folder / f"{name}.yaml").write_text(f"# Of {package}\n{text}\n")
    about = root / f"{package}-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\n")
    (about / "entry_points.txt").write_text(f"[vprbench.conf]\n{point} = {package}_conf\n")
    entries._find_plugins.cache_clear()


def see_plugins(root, monkeypatch):
    """Let this process and those that it starts find what was installed there, and the modules of tests."""
    monkeypatch.syspath_prepend(root)
    monkeypatch.setattr(entries, "_find_plugins", cache(entries._find_plugins.__wrapped__))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (root, ROOT / "tests" / "support", ROOT))))
