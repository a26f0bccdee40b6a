"""The doctor: looks through a dataset and says what is wrong with it and what to do."""

from .examination import check_dataset, command, examine, look_at_some, quick
from .finding import Finding, as_text
from .lists import step_in_dictionary_order

__all__ = [
    "Finding",
    "as_text",
    "check_dataset",
    "command",
    "examine",
    "look_at_some",
    "quick",
    "step_in_dictionary_order",
]
