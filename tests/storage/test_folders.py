"""Where no home is known, one line says what to set."""

import pwd
from pathlib import Path

import pytest

from vprbench.api.checkpoints import partial_folder
from vprbench.api.weights import weights_folder
from vprbench.errors import BadInput
from vprbench.storage.hashes import hashes_folder

FOLDERS = {"VPRBENCH_WEIGHTS": weights_folder, "VPRBENCH_PARTIAL": partial_folder, "VPRBENCH_HASHES": hashes_folder}


@pytest.fixture(autouse=True)
def nameless(monkeypatch, tmp_path):
    """Be a user without a name and a home, as in many a container."""

    def unknown(_):
        raise KeyError("uid not found")

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in ("HOME", "XDG_CACHE_HOME", *FOLDERS):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("variable", FOLDERS)
def test_a_cache_without_a_home_asks_for_its_variable(variable, monkeypatch):
    with pytest.raises(BadInput, match=f"HOME, or {variable}"):
        FOLDERS[variable]()
    monkeypatch.setenv(variable, "~/kept")
    with pytest.raises(BadInput, match=f"{variable}=~/kept"):
        FOLDERS[variable]()
    monkeypatch.setenv(variable, "kept")
    assert FOLDERS[variable]() == Path("kept")
