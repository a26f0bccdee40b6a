"""Plug-ins, yamls and loose files of methods for a test, and for the processes that it starts too."""

import os
import sys
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


def see_yamls(folder, monkeypatch):
    """Let this process find the yamls of a folder beside those of packages; returns what writes one of a method."""
    folders = {**entries.find_conf_folders(), "other": folder}
    monkeypatch.setattr("vprbench.plugins.entries.find_conf_folders", lambda: folders)

    def write(name, text):
        path = folder / "method" / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    return write


def forget_loose_files(monkeypatch):
    """Let what loose files leave in this process be gone after the test."""
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    monkeypatch.setattr(sys, "path", [*sys.path])
