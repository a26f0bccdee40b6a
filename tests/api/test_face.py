"""`vprbench.api` is the one module of ours that plug-ins see, and it costs no more than what they ask it for."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest
from checkout import ROOT

import vprbench
from vprbench import api
from vprbench.api.images import Images

DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def written_for_plug_ins() -> Iterator[tuple[str, str]]:
    """The Python files of plug-ins and the Python blocks of documents, by where they stand."""
    for folder in ("methods", "datasets", "tests/example_plugin"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
    for path in DOCUMENTS:
        for number, block in enumerate(re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)):
            yield f"{path.name}, block {number + 1}", block


def ours(code: str) -> set[str]:
    """The modules of this project that some code imports, but for other plug-ins."""
    found = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and not node.level:
            found.add(str(node.module))
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if re.fullmatch(r"vprbench(\.(?!methods\b|datasets\b).*)?", name)}


def test_plug_ins_and_examples_import_the_face_alone() -> None:
    seen = dict(written_for_plug_ins())
    programs = {where for where in seen if ", block " in where}  # of documents, which may be no plug-ins
    more = {where: ours(code) - {"vprbench.api", *["vprbench"] * (where in programs)} for where, code in seen.items()}
    assert {where: found for where, found in more.items() if found} == {}
    assert sum("vprbench.api" in ours(code) for code in seen.values()) > 40
    assert any(where.startswith("README.md") for where in seen)


def test_documents_name_no_module_that_is_not_there() -> None:
    # Names of attributes follow a module after a dot; `vprbench.pth` and the like are no modules.
    missing = []
    for path in [*DOCUMENTS, ROOT / "CONTRIBUTING.md"]:
        for dotted in set(re.findall(r"\bvprbench(?:\.[a-z_]+)+", path.read_text(encoding="utf-8"))):
            parts = dotted.split(".")[1:]
            known = ROOT.joinpath("vprbench", *parts).is_dir() or any(
                ROOT.joinpath("vprbench", *parts[:n]).with_suffix(".py").is_file() for n in range(1, len(parts) + 1)
            )
            offered = hasattr(api, parts[-1]) or parts[0] in vprbench.__all__
            if not known and parts[:1] not in (["conf"], ["methods"], ["datasets"]) and not offered:
                missing.append((path.name, dotted))
    assert missing == []


@pytest.mark.parametrize("name", api.__all__)
def test_each_name_leads_to_its_home(name: str) -> None:
    found = getattr(api, name)
    assert found is sys.modules[api.HOMES[name]] or found is getattr(sys.modules[api.HOMES[name]], name)
    assert getattr(found, "__module__", api.HOMES[name]) in (api.HOMES[name], "types", "typing", "numpy")


def test_an_unknown_name_raises_with_the_near_names() -> None:
    with pytest.raises(AttributeError, match=r"\bImags\b.*\bImages\b"):
        _ = api.Imags
    with pytest.raises(AttributeError, match=r"Images, .*Search"):
        _ = api.zzz
    assert api.Images is Images


TORCH_NEEDED = {
    "GaborBank",
    "NeuralDescriptor",
    "OrientedEdges",
    "PatchNormalisation",
    "Variant",
    "Interpolation",
    "Resize",
    "packed",
}


def test_what_needs_no_torch_does_not_wait_for_it() -> None:
    code = f"""
import sys, vprbench.api as api
slow = {{'torch', 'matplotlib', 'faiss', 'numba'}}
face = slow & {{*sys.modules}}
for name in {sorted({*api.__all__} - TORCH_NEEDED)}: getattr(api, name)
import numpy as np
api.Search(np.eye(3, dtype=np.float32), np.arange(3)).scores(np.eye(3, dtype=np.float32))
print(face, 'torch' in sys.modules or 'faiss' in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["set()", "False"]


def test_nobody_but_the_registry_imports_a_plug_in() -> None:
    """Ruff bans `importlib`'s ways (TID251); here it is names of plug-ins in imports and in texts."""
    found = []
    for path in sorted((ROOT / "vprbench").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            if any(re.match(r"(vprbench\.)?(methods|datasets)\b", name) for name in names):
                found.append(str(path.relative_to(ROOT)))
    assert found == []
