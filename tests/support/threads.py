"""As many threads of PyTorch as a test wants."""

from contextlib import contextmanager

import torch


@contextmanager
def torch_threads(count):
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
