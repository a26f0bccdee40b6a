"""The errors by which a user or a plug-in learns what is wrong."""


class BadInput(ValueError):
    """What a user can mend; the message is one line that names the culprit, what came and what to do."""


class NotThere(BadInput):
    """Weights or frames that a run needs are missing; it can run once somebody has fetched them or put them there."""


class NotFittedError(RuntimeError):
    """A method was asked to match before it had learnt a map."""


class TrainingDivergedError(RuntimeError):
    """A training ended in a network that cannot be trusted; the message says how that was seen."""


class ClusterLostError(RuntimeError):
    """What makes cells elsewhere is gone; the same command goes on with what is left."""
