"""Words and numbers for people: every number that is read by a person is formatted here."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Any

NOTHING = "-"  # a number that there is not


def join_names(names: Iterable[Any], most: int = 5) -> str:
    """Return the first `most` names as text, and how many more there are."""
    listed = [str(name) for name in names]
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(listed[:most]) + more


def join_few(names: Iterable[Any]) -> str:
    """Return the first three names as text, and how many more there are."""
    return join_names(names, most=3)


def format_count(number: int, one: str) -> str:
    """Return a number with its noun, as in "1 query" and "2,761 queries"."""
    many = f"{one[:-1]}ies" if one.endswith("y") else f"{one}s"
    return f"{number:,} {one if number == 1 else many}"


def pick_verb(names: Sequence[str]) -> str:
    """Return the verb that fits so many names: is or are."""
    return "is" if len(names) == 1 else "are"


def escape_unprintable(text: str, but: str = "") -> str:
    r"""Return `text` with its control characters, line breaks among them, as \n and \x1b; those in `but` stay."""
    return "".join(c if c.isprintable() or c in but else c.encode("unicode_escape").decode() for c in text)


def shorten(text: str) -> str:
    """Return text in one line of at most 100 letters; of a longer one the middle is left out."""
    line = escape_unprintable(" ".join(text.split()))
    return line if len(line) <= 100 else f"{line[:48]} ... {line[-47:]}"


def suggest_names(name: str, known: Iterable[str]) -> str:
    """Return the part of an error message that names the known names nearest to `name`, or all if none is near."""
    known = list(known)
    if close := difflib.get_close_matches(name, known, n=3):
        return f"did you mean {' or '.join(close)}?"
    return f"there {pick_verb(known)} {', '.join(known)}"


def format_percent(share: float | None, digits: int = 1) -> str:
    """Return a share, 0 to 1, in percent without its sign: "12.5"; a dash for None."""
    return NOTHING if share is None else f"{100 * share:.{digits}f}"


def format_signed_percent(share: float) -> str:
    """Return a difference of shares in percent with its sign: "+1.5", and "+0.0" for all that rounds to 0."""
    return f"{round(100 * share, 1) + 0.0:+.1f}"


def format_interval(low: float, high: float) -> str:
    """Return the ends of an interval of shares, 0 to 1, in percent: "[76.4, 99.1]"."""
    return f"[{format_percent(low)}, {format_percent(high)}]"


def format_rate(hertz: float) -> str:
    """Return a rate in Hz without its unit: "15,120" from 10 Hz on, and two digits below."""
    return _strip_zeros(format_two_digits(hertz))


def format_seconds(seconds: float) -> str:
    """Return seconds without their unit: "12.3" from 10 s on, and two digits below."""
    return f"{seconds:.1f}" if seconds >= 10 else _strip_zeros(format_two_digits(seconds))


def format_duration(seconds: float) -> str:
    """Return a duration with its unit: "45 s", "12 min" or "1.5 h"."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds <= 3600 else f"{seconds / 3600:.1f} h"


def format_bytes(size: int) -> str:
    """Return a number of bytes with its unit, to three digits: "17 MB"."""
    for unit, name in ((10**9, "GB"), (10**6, "MB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size} bytes"


def format_megabytes(size: float) -> str:
    """Return a number of bytes as whole MB without the unit: "353"."""
    return f"{size / 1e6:.0f}"


def format_two_digits(value: float) -> str:
    """Return a number with two digits, or with all that stand before the point: "2.0", "0.050", "353"."""
    return _format_digits(value, 2)


def format_three_digits(value: float) -> str:
    """Return a number to three digits, without powers of ten and zeros at its end: "0.05", "353", "15,120"."""
    return _strip_zeros(_format_digits(value, 3))


def format_spread(spread: float, beside: str) -> str:
    """Return a spread with as many decimals as the number beside it, or as many as it takes to see it."""
    return _format_digits(spread, 1, len(beside.partition(".")[2]))


def _format_digits(value: float, digits: int, decimals: int = 0) -> str:
    """Return a number to so many digits, but to that many decimals at least."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])  # of the rounded number: 9.96 with two digits is 10
    return f"{value:,.{max(decimals, digits - 1 - exponent)}f}"


def _strip_zeros(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text
