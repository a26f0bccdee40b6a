"""Runs without what takes longest in them where nobody looks at how exactly they are timed."""

from vprbench.runs import machine


def quick_runs(monkeypatch):
    """Let a run neither collect garbage before it times something nor look for a disturbed machine."""
    monkeypatch.setattr("gc.collect", int)
    monkeypatch.setattr(machine, "time_canary", lambda: 1.0)
