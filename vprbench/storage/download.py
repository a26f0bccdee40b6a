"""Files from the net: resumed after an interruption, and checked before they get their name."""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import re
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from vprbench.errors import BadInput, NotThere
from vprbench.progress import report

logger = logging.getLogger(__name__)

_PARTIAL = ".part"  # beside the destination: a folder with what has come, and of which version of the remote file
_WHOLE, _VERSION = "whole", "version.json"
_ATTEMPTS = 5  # in a row that bring nothing new
_LONGEST_PAUSE = 30.0  # seconds
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})  # HTTP statuses that another attempt may mend
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


class _Refused(Exception):
    """A file cannot be had; the message continues a sentence that begins with its address."""


@dataclass(frozen=True)
class _Wanted:
    url: str
    size_bytes: int | None
    sha256: str | None
    timeout_seconds: float
    pause_seconds: float


def fetch(
    url: str,
    destination: Path,
    *,
    size_bytes: int | None = None,
    sha256: str | None = None,
    timeout_seconds: float = 30.0,
    pause_seconds: float = 1.0,
) -> None:
    """Download a file, unless it is there; what an interrupted download has left is continued.

    `timeout_seconds` is how long a server may be silent, `pause_seconds` the wait before a second attempt, twice as
    long before each further one. Raises NotThere, and leaves no file, if the server refuses, keeps silent, or
    gives a web page or a file of another size or SHA-256 than stated, and BadInput if the disk is full.
    """
    from filelock import FileLock

    wanted = _Wanted(url, size_bytes, sha256, timeout_seconds, pause_seconds)
    folder = destination.with_name(f"{destination.name}{_PARTIAL}")
    stage = f"downloading {destination.name}"
    report(stage, 0.0)
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(destination.with_name(f".{destination.name}.lock")):  # another run may be at it: then wait
            if not destination.exists():
                folder.mkdir(exist_ok=True)
                _transfer(wanted, folder, stage)
                _check(wanted, folder)
                with (folder / _WHOLE).open("rb+") as file:
                    os.fsync(file.fileno())
                (folder / _WHOLE).replace(destination)
                shutil.rmtree(folder)
    except _Refused as refusal:
        raise NotThere(f"{url} {refusal}; or get the file by hand and store it as {destination}") from refusal
    except OSError as error:
        advice = "free some space" if error.errno in _FULL else "mend that"
        raise BadInput(f"{destination} cannot be written ({error.strerror}): {advice} and run again") from error
    report(stage, 1.0)


def kept_bytes(destination: Path) -> int:
    """Return how much an interrupted download of a file has left, which the next one continues."""
    return _received_bytes(destination.with_name(f"{destination.name}{_PARTIAL}"))


def _transfer(wanted: _Wanted, folder: Path, stage: str) -> None:
    """Bring the whole file into a folder, in several attempts."""
    if urlsplit(wanted.url).scheme not in ("http", "https"):
        raise _Refused("does not start with http:// or https://: give another address")
    if wanted.sha256 is None and _version(folder) is None:
        _discard(folder)  # an earlier run's part: nothing would tell that the file has changed since

    def progressed(done_bytes: int, total_bytes: int | None) -> None:
        total_bytes = total_bytes or wanted.size_bytes
        report(stage, min(done_bytes / total_bytes, 1.0) if total_bytes else 0.0)

    most, failures = _received_bytes(folder), 0
    while not (folder / _WHOLE).exists():
        reason = _attempt(wanted, folder, progressed)
        if reason is None:
            return
        received = _received_bytes(folder)
        most, failures = max(most, received), (1 if received > most else failures + 1)
        if failures >= _ATTEMPTS:
            raise _Refused(f"could not be downloaded ({reason}): run again later, {received} bytes are kept")
        logger.info("%s: %s, attempt %d follows", wanted.url, reason, failures + 1)
        time.sleep(min(wanted.pause_seconds * 2 ** (failures - 1), _LONGEST_PAUSE))


def _attempt(wanted: _Wanted, folder: Path, progressed: Callable[[int, int | None], None]) -> str | None:
    """Bring the missing bytes; returns None, or why another attempt is worthwhile. Raises _Refused if no attempt is."""
    import gdown
    import requests
    from gdown.parse_url import is_google_drive_url
    from urllib3.exceptions import NameResolutionError

    try:
        if not is_google_drive_url(wanted.url):  # it answers a plain request with a page, which gdown follows
            _discard_what_does_not_fit(wanted, folder)
        gdown.download(
            wanted.url,
            str(folder / _WHOLE),
            quiet=True,
            use_cookies=False,
            resume=True,
            progress=progressed,
            timeout=wanted.timeout_seconds,
        )
    except requests.HTTPError as error:
        if error.response is None or error.response.status_code in _PASSING:
            return _line(error)
        status = f"{error.response.status_code} {error.response.reason}"
        raise _Refused(f"answers {status}: give the address where it is now") from error
    except requests.exceptions.SSLError as error:
        raise _Refused(f"has no valid certificate ({_line(error)}): mend the connection") from error
    except (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError) as error:
        if isinstance(_reason(error), NameResolutionError):
            raise _Refused(
                f"cannot be reached ({_line(error)}): run again with a connection to the internet"
            ) from error
        return _line(error)
    except requests.RequestException as error:
        raise _Refused(f"cannot be followed ({_line(error)}): give another address") from error
    except gdown.FileURLRetrievalError as error:
        raise _Refused(f"is not given to programs ({_line(error)}): try again in a day") from error
    except gdown.DownloadError as error:
        return _line(error).partition(". ")[0]  # then come options of its own command line
    return None


def _discard_what_does_not_fit(wanted: _Wanted, folder: Path) -> None:
    """Ask the server for the rest of the version that a part is of; delete the part if it has another version."""
    import requests

    had, version = _received_bytes(folder), _version(folder)
    headers = {"Accept-Encoding": "identity"}  # the bytes of the file itself, not of an archive of it
    if had:
        headers["Range"] = f"bytes={had}-"
        if version is not None:
            headers["If-Range"] = version
    with requests.get(wanted.url, headers=headers, stream=True, timeout=wanted.timeout_seconds) as answer:
        if had and answer.status_code == requests.codes.partial_content:
            return
        too_long = had and answer.status_code == requests.codes.requested_range_not_satisfiable
        if not too_long:
            answer.raise_for_status()
    _discard(folder)
    if too_long:
        _discard_what_does_not_fit(wanted, folder)
    else:
        strong = not answer.headers.get("ETag", "W/").startswith("W/")
        version = answer.headers.get("ETag" if strong else "Last-Modified")
        (folder / _VERSION).write_text(json.dumps(version), encoding="utf-8")


def _version(folder: Path) -> str | None:
    """Return what tells the version of the remote file that a part is of, None if nothing does."""
    try:
        version = json.loads((folder / _VERSION).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return version if isinstance(version, str) else None


def _received_bytes(folder: Path) -> int:
    return sum(part.stat().st_size for part in folder.glob(f"{_WHOLE}*{_PARTIAL}"))


def _discard(folder: Path) -> None:
    for path in [*folder.glob(f"{_WHOLE}*{_PARTIAL}"), folder / _VERSION]:
        path.unlink(missing_ok=True)


def _check(wanted: _Wanted, folder: Path) -> None:
    """Compare the file that has come with the stated size and hash; deletes it and raises _Refused if they differ."""
    whole = folder / _WHOLE
    with whole.open("rb") as file:
        start = file.read(512).lstrip(b"\xef\xbb\xbf \t\r\n").lower()
        file.seek(0)
        sha256 = hashlib.file_digest(file, "sha256").hexdigest() if wanted.sha256 else None
    came = whole.stat().st_size
    if start.startswith((b"<!doctype html", b"<html")):
        problem = "answers with a web page instead of a file (a login?)"
    elif came == 0 or wanted.size_bytes not in (None, came):
        problem = f"gave {came} bytes, expected {wanted.size_bytes or 'more'}"
    elif wanted.sha256 is not None and sha256 != wanted.sha256.lower():
        problem = f"gave a file with SHA-256 {sha256}, expected {wanted.sha256}"
    else:
        return
    shutil.rmtree(folder)
    raise _Refused(f"{problem}: it was deleted, run again")


def _line(error: Exception) -> str:
    """Return an error as one line: libraries indent, wrap and nest theirs."""
    text = " ".join(str(_reason(error)).split())
    return re.sub(r"^<?\w+\(.*?\)>?: ", "", text) or type(error).__name__


def _reason(error: Exception) -> object:
    """Return why a connection failed, out of the error that only says that it did."""
    return getattr(error.args[0], "reason", None) or error if error.args else error
