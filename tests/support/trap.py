"""What leaves a mark on the disk if it is ever unpickled."""

from pathlib import Path


class Trap:
    """Unpickling it makes a file."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)
