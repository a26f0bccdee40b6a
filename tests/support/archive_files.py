"""Archives for the tests, honest and hostile ones."""

import io
import tarfile
import zipfile


def zipped(files):
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return memory.getvalue()


def tarred(files, extra=(), compression="gz"):
    """A tar with `files`, then members without content as they are given."""
    memory = io.BytesIO()
    with tarfile.open(fileobj=memory, mode=f"w:{compression}") as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
        for info in extra:
            archive.addfile(info)
    return memory.getvalue()


def special(name, kind, target=""):
    """A member that is no file: a link to `target`, a device, a pipe."""
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info
