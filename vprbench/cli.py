"""The command line: which command, its exit code, and the one place where errors become words."""

from __future__ import annotations

import io
import re
import signal
import sys
from collections.abc import Sequence

from vprbench import __version__
from vprbench.commands.catalogue import COMMANDS, COMPLETE
from vprbench.errors import BadInput, ClusterLostError, format_error
from vprbench.terminal.streams import complain, log_to_stderr
from vprbench.text import near


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for a run that failed, 2 for input to be mended."""
    log_to_stderr()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that knows no arrows shows something else
            stream.reconfigure(errors="replace")
    words = [
        "wide=true" if argument == "--wide" else argument
        for argument in (sys.argv[1:] if arguments is None else arguments)
    ]
    try:
        code = _call(words)
        sys.stdout.flush()
        return code
    except BadInput as error:
        return _fail(format_error(error))
    except ClusterLostError as error:
        return _fail(str(error), 1)
    except BrokenPipeError:
        sys.stdout = io.StringIO()  # which the interpreter flushes in the end
        return _fail("standard output was closed before all was printed", 1)
    except KeyboardInterrupt as error:
        code = 128 + int((error.args or (signal.SIGINT,))[0])
        return _fail("interrupted; what was finished before is kept: give the same command again", code)
    except OSError as error:
        return _fail(f"{error.filename or 'a file'}: {error.strerror or error}")


def _call(arguments: list[str]) -> int:
    """Answer a request for help, or call the command that the first argument names; raises BadInput for none."""
    name, *options = arguments or ["help"]
    if name in ("help", "--version", COMPLETE) or {"--help", "-h"} & {*arguments}:
        _help(name, options if name == "help" else arguments)
        return 0
    name, options = _split(arguments)
    try:
        return COMMANDS[name].call(options)
    except SystemExit as error:  # a plug-in's
        return _fail(format_error(error), 1)


def _help(name: str, arguments: list[str]) -> None:
    """Print the version, the help of all commands or of one, or the words that complete a line."""
    from vprbench.commands.help import complete, print_commands, print_options

    arguments = [each for each in arguments if each not in ("--help", "-h")]
    if name == "--version":
        print(f"vprbench {__version__}")
    elif name == COMPLETE:
        print("\n".join(complete(" ".join(arguments[1:]))))
    elif arguments:
        print_options(*_split(arguments))
    else:
        print_commands()


def _split(arguments: list[str]) -> tuple[str, list[str]]:
    """Return the command that the arguments name, and its own arguments; raises BadInput for an unknown one."""
    name = arguments[0]
    if re.fullmatch(r"\w[\w-]*", name) is None:
        return "run", arguments
    if name not in COMMANDS:
        from vprbench.runs.request import OPTIONS

        raise BadInput(f"give {name}=value" if name in OPTIONS else f"{name} is no command: {near(name, COMMANDS)}")
    return name, arguments[1:]


def _fail(message: str, code: int = 2) -> int:
    complain(message)
    return code
