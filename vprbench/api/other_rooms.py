"""Names of other rooms that methods and datasets may use."""

from vprbench import progress as progress
from vprbench.errors import BadInput as BadInput
from vprbench.errors import MissingData as MissingData
from vprbench.errors import NotFittedError as NotFittedError
from vprbench.errors import TrainingDivergedError as TrainingDivergedError
from vprbench.storage.atomic import replace_bytes as replace_bytes
from vprbench.storage.folders import cache_folder as cache_folder
from vprbench.storage.folders import checkout_folder as checkout_folder
from vprbench.storage.folders import data_folder as data_folder
from vprbench.storage.mat_files import MatFileError as MatFileError
from vprbench.storage.mat_files import read_mat as read_mat
from vprbench.storage.paths import Paths as Paths
from vprbench.storage.paths import natural_keys as natural_keys
