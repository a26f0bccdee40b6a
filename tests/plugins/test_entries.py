"""Entries are read by plain yaml: fast, without Hydra, and as Hydra would read them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, entries


def test_reading_all_entries_imports_neither_hydra_nor_anything_that_computes() -> None:
    read = "[(e.options, e.tags, e.description) for g in ('method', 'dataset') for e in entries(g).values()]"
    heavy = "{'hydra', 'omegaconf', 'torch', 'numpy', 'pydantic', 'vprbench.methods'} & {*sys.modules}"
    program = f"import sys; from vprbench.plugins.entries import entries; {read}; print({heavy})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_a_yaml_holds_what_hydra_reads_in_it_and_tells_what_computes_by_spikes_or_needs_weights() -> None:
    for entry in (*entries("method").values(), *entries("dataset").values()):
        told, read = OmegaConf.to_container(OmegaConf.load(entry.path)), entry.values()
        assert isinstance(told, dict)
        assert {name: read[name] for name in told if name != "weights"} == {n: told[n] for n in told if n != "weights"}
        assert entry.tags == (("spiking",) if entry.name.startswith(("vprtempo", "vprsnn", "lens")) else ())
    needy = {name for name, entry in entries("method").items() if entry.needs_weights}
    assert {"netvlad", "megaloc", "boq_resnet50"} <= needy
    assert not {"sad", "hog", "vprtempo", "densevlad"} & needy


def test_tags_are_a_list_of_words(tmp_path: Path) -> None:
    (tmp_path / "one.yaml").write_text("tags: spiking\n")
    with pytest.raises(BadInput, match=r"one\.yaml: tags=spiking"):
        _ = Entry("method", "one", tmp_path / "one.yaml", "other").tags
