"""The names of `vprbench`, each imported when a program asks for it."""

from .interactive.choices import (
    NamedDataset as NamedDataset,
)
from .interactive.choices import (
    NamedMethod as NamedMethod,
)
from .interactive.choices import (
    dataset as dataset,
)
from .interactive.choices import (
    method as method,
)
from .interactive.comparison import Comparison as Comparison
from .interactive.comparison import compare as compare
from .interactive.images import dataset_of as dataset_of
from .interactive.known import datasets as datasets
from .interactive.known import methods as methods
from .interactive.known import results as results
from .interactive.result import Result as Result
from .interactive.running import run as run

__version__: str
