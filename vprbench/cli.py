"""The command line: which command, its exit code, and the one place where errors become words."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Sequence

from vprbench import __version__
from vprbench.commands.catalogue import COMMANDS
from vprbench.errors import BadInput, ClusterLostError, format_error
from vprbench.terminal.streams import complain, log_to_stderr
from vprbench.text import suggest_names

_COMPLETE = "__complete"  # the hidden command of completion scripts: a line -> the words that its last may become


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns the exit code: 0, 1 for a run that failed, 2 for input to be mended. Raises KeyboardInterrupt alone.
    """
    log_to_stderr()
    try:
        code = _call_command([*(sys.argv[1:] if arguments is None else arguments)])
        sys.stdout.flush()
        return code
    except BadInput as error:
        message, code = format_error(error), 2
    except (SystemExit, ClusterLostError) as error:  # SystemExit: a plug-in's
        message, code = format_error(error), 1
    except BrokenPipeError:
        sys.stdout = io.StringIO()  # which the interpreter flushes in the end
        message, code = "standard output was closed before all was printed", 1
    except OSError as error:
        message, code = f"{error.filename or 'a file'}: {error.strerror or error}", 2
    complain(message)
    return code


def _call_command(arguments: list[str]) -> int:
    """Answer a request for help, or call the command that the first argument names; raises BadInput for none."""
    name = arguments[0] if arguments else "help"
    rest = [each for each in arguments if each not in ("--help", "-h")]
    if name == "--version":
        print(f"vprbench {__version__}")
    elif name in ("help", _COMPLETE) or rest != arguments:
        from vprbench.commands.help import complete, print_commands, print_options

        rest = rest[name in ("help", _COMPLETE) :]
        if name == _COMPLETE:
            print("\n".join(complete(" ".join(rest))))
        elif rest:
            print_options(*_split_command(rest))
        else:
            print_commands()
    else:
        name, options = _split_command(arguments)
        return COMMANDS[name].call(options)
    return 0


def _split_command(arguments: list[str]) -> tuple[str, list[str]]:
    """Return the command that the arguments name, and its own arguments; raises BadInput for an unknown one."""
    name = arguments[0]
    if re.fullmatch(r"\w[\w-]*", name) is None:
        return "run", arguments
    if name not in COMMANDS:
        raise BadInput(f"{name} is no command: {suggest_names(name, COMMANDS)}")
    return name, arguments[1:]
