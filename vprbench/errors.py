"""The errors by which a user or a plug-in learns what is wrong, and the words of any error."""

import os


class BadInput(ValueError):
    """An error that the user can fix: one line names the option or file, its value and the remedy."""


class MissingData(BadInput):
    """Weights or frames that a run needs are missing; it can run once somebody has fetched them or put them there."""


class NotFittedError(RuntimeError):
    """A method was asked to match before it had learnt a map."""


class TrainingDivergedError(RuntimeError):
    """A training ended in a network that cannot be trusted; the message says how that was seen."""


class ClusterLostError(RuntimeError):
    """The processes that make cells elsewhere are gone; the same command goes on with the rest."""


def format_error(error: BaseException) -> str:
    """Return an error as "Kind: message", or the message alone of an error of ours; a plug-in's message may fail."""
    if isinstance(error, SystemExit):
        return f"SystemExit: the method or dataset ended the program, with exit code {error.code or 0}"
    try:
        text = str(error)
    except Exception as unsaid:
        text = f"(its text fails: {type(unsaid).__name__})"
    if isinstance(error, BadInput | ClusterLostError):
        return text.strip() or "invalid input; the plug-in gave no reason"
    return f"{type(error).__name__}: {text}"


def hide_home(text: str) -> str:
    """Return an error without the name of the user's home folder, for a table may print it."""
    home = os.path.expanduser("~")  # noqa: PTH111 - which leaves it as it is where nobody knows the home
    return text if home in ("~", "/", "") else text.replace(home, "~")
