"""The names of `vprbench`, each imported when a program asks for it."""

from .python.choices import (
    NamedDataset as NamedDataset,
)
from .python.choices import (
    NamedMethod as NamedMethod,
)
from .python.choices import (
    dataset as dataset,
)
from .python.choices import (
    method as method,
)
from .python.comparison import Comparison as Comparison
from .python.comparison import compare as compare
from .python.images import dataset_of as dataset_of
from .python.known import datasets as datasets
from .python.known import methods as methods
from .python.known import results as results
from .python.result import Result as Result
from .python.running import run as run

__version__: str
