"""Methods that do to a run what a plug-in may do: each is SAD, after it has done something in `fit`."""

import os
import sys

from little import Prototypes

from vprbench.errors import BadInput
from vprbench.methods.sad import SAD


class Leaving(SAD):
    def fit(self, *given):
        sys.exit()


class Silent(SAD):
    def fit(self, *given):
        raise BadInput


class Colourful(SAD):
    def fit(self, *given):
        os.chdir("/")
        raise RuntimeError("a name\x1b[31m\nvprbench: all is well")


class Rootless(SAD):
    def fit(self, *given):
        raise GeneratorExit("a name\x1b[31m\nvprbench: all is well")


class Moving(Prototypes):
    def fit(self, *given):
        os.chdir("/")
        return super().fit(*given)
