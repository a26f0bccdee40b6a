"""Methods that do to a run what a plug-in may do: each is SAD, after it has done something in `fit`."""

import atexit
import ctypes
import os
import signal
import sys
import time

from little import Prototypes

from vprbench.errors import BadInput
from vprbench.methods.sad import SAD


class Crashing(SAD):
    def fit(self, *given):
        ctypes.string_at(0)
        return super().fit(*given)


class Leaving(SAD):
    def fit(self, *given):
        sys.exit()


class Hanging(SAD):
    def fit(self, *given):
        signal.signal(signal.SIGALRM, signal.SIG_IGN)  # as what has time limits of its own
        time.sleep(600)
        return self


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


class Unruly(SAD):
    def fit(self, *given):
        print('{"method": "mine"}')
        os.write(1, b"{}\n")
        os.system("echo from a shell")
        atexit.register(print, "bye")
        os.close(1)
        os.chdir("/")
        os.fork()
        return super().fit(*given)


class Moving(Prototypes):
    def fit(self, *given):
        os.chdir("/")
        return super().fit(*given)
