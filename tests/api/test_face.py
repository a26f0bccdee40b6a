"""`vprbench.api` is the one module of ours that plug-ins see, and it costs no more than what they ask it for."""

import subprocess
import sys

import pytest
from checkout import ROOT

from vprbench import api
from vprbench.api.images import Images


def test_each_name_leads_to_its_home_and_an_unknown_one_raises_with_the_near_names():
    for name in api.__all__:
        found, home = getattr(api, name), sys.modules[api.HOMES[name]]
        assert found is home or found is getattr(home, name)
        assert getattr(found, "__module__", api.HOMES[name]) in (api.HOMES[name], "types", "typing", "numpy")
    assert api.Images is Images
    with pytest.raises(AttributeError, match=r"\bImags\b.*\bImages\b"):
        _ = api.Imags
    with pytest.raises(AttributeError, match=r"Images, .*Search"):
        _ = api.zzz


def test_what_needs_no_torch_does_not_wait_for_it():
    with_torch = {"GaborBank", "NeuralDescriptor", "OrientedEdges", "PatchNormalisation", "Variant", "packed"}
    free = sorted({*api.__all__} - with_torch - {"Interpolation", "Resize"})
    code = f"""
import sys, vprbench.api as api
face = {{'torch', 'matplotlib', 'faiss', 'numba'}} & {{*sys.modules}}
for name in {free}: getattr(api, name)
import numpy as np
api.Search(np.eye(3, dtype=np.float32), np.arange(3)).scores(np.eye(3, dtype=np.float32))
print(face, 'torch' in sys.modules or 'faiss' in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["set()", "False"]
