"""The doctor: looks through a dataset and says what is wrong with it and what to do."""

from .examination import command, examine, insist, quick
from .finding import Finding, as_text

__all__ = ["Finding", "as_text", "command", "examine", "insist", "quick"]
