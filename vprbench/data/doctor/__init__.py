"""The doctor: looks through a dataset and says what is wrong with it and what to do."""

from .examination import examine, insist, quick
from .finding import Finding
from .text import as_data, as_text, command

__all__ = ["Finding", "as_data", "as_text", "command", "examine", "insist", "quick"]
