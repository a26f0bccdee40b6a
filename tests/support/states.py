"""Whether two stored networks are the same, and one member of a stored ensemble."""

import numpy as np


def same(one, other):
    return one.keys() == other.keys() and all(np.array_equal(array, other[name]) for name, array in one.items())


def member(state, number):
    start = f"member_{number}."
    return {name.removeprefix(start): array for name, array in state.items() if name.startswith(start)}
