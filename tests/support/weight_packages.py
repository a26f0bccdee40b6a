"""Packages of weights installed for a test, whose code must not run."""


def install(root, package, files, monkeypatch, lost=()):
    """Install a package that brings files, by their paths, and lists some that were lost; it fails when imported."""
    module = package.replace("-", "_")
    files = {f"{module}/__init__.py": b"raise AssertionError('it was imported')\n", **files}
    for path, content in files.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(content)
    about = root / f"{module}-9.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 9\n")
    (about / "RECORD").write_text("".join(f"{path},,\n" for path in (*files, *lost)))
    monkeypatch.syspath_prepend(root)
