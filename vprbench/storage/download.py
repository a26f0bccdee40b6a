"""Files from the net: gdown resumes and retries, and a file gets its name after its size and SHA-256 are checked."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from vprbench.errors import BadInput, MissingData
from vprbench.progress import report

_RETRIES = 3  # in one call; after that the part stays for the next call


def fetch(
    url: str,
    destination: Path,
    *,
    size_bytes: int | None = None,
    sha256: str | None = None,
    resume: bool = True,
    timeout_seconds: float = 30.0,
) -> None:
    """Download a file, unless it is there.

    Args:
        url: An address of http or https; Google Drive's page of confirmation is passed.
        destination: Where the file goes. Two processes that want one file download it once.
        size_bytes: Its stated size; None: the source states none.
        sha256: Its stated SHA-256, in hexadecimal; None: the source states none.
        resume: Whether to continue the part that an earlier call left. False: where nobody would notice that the
            remote file has changed since.
        timeout_seconds: How long a server may be silent.

    Raises:
        MissingData: The server gives no file, a web page, or a file of another size or SHA-256. No file is left.
        BadInput: The disk refuses.
    """
    from filelock import FileLock

    folder = destination.with_name(f"{destination.name}.part")
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(destination.with_name(f".{destination.name}.lock")):
            if destination.exists():
                return
            if not resume:
                shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(exist_ok=True)
            whole = folder / "whole"
            if problem := _download(url, whole, destination.name, size_bytes, sha256, timeout_seconds):
                whole.unlink(missing_ok=True)  # the part of an unfinished download has another name
                by_hand = f"get the file by hand and store it as {destination}"
                raise MissingData(f"{url} {problem}: run again later, or {by_hand}")
            whole.replace(destination)
            shutil.rmtree(folder)
    except OSError as error:
        raise BadInput(
            f"{destination} cannot be written ({error.strerror}): free some space, or choose another folder"
        ) from error


def _download(
    url: str, whole: Path, name: str, size_bytes: int | None, sha256: str | None, timeout_seconds: float
) -> str | None:
    """Bring a file; returns the reason if that fails or another file than stated came."""
    import gdown
    import requests

    def show(done_bytes: int, total_bytes: int | None) -> None:
        total_bytes = total_bytes or size_bytes
        report(f"downloading {name}", min(done_bytes / total_bytes, 1.0) if total_bytes else 0.0)

    digest = hashlib.sha256()
    show(0, None)
    try:
        gdown.download(
            url,
            str(whole),
            quiet=True,
            use_cookies=False,
            resume=True,
            retries=_RETRIES,
            progress=show,
            hasher=digest,
            timeout=timeout_seconds,
        )
    except (requests.RequestException, gdown.FileURLRetrievalError, gdown.DownloadError) as error:
        if "did not honor" in str(error):  # the server does not continue this part
            shutil.rmtree(whole.parent)
        return f"gives no file ({_find_cause(error)})"
    with whole.open("rb") as content:
        start = content.read(512).lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    came = whole.stat().st_size
    if start.startswith((b"<!doctype html", b"<html")):
        return "gave a web page instead of a file (a login?)"
    if came == 0 or size_bytes not in (None, came):
        return f"gave {came} bytes, expected {size_bytes or 'more'}"
    if sha256 and digest.hexdigest() != sha256.lower():
        return f"gave a file with SHA-256 {digest.hexdigest()}, expected {sha256}"
    return None


def _find_cause(error: BaseException) -> str:
    """Return the words of the system's error that an error of a library goes back to, else its own first sentence."""
    deepest = error
    while cause := deepest.__cause__ or deepest.__context__:
        deepest = cause
    return getattr(deepest, "strerror", None) or " ".join(str(error).split()).partition(". ")[0]
