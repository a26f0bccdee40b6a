"""What TAB completes in a shell, and the scripts that let bash, zsh and fish ask for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from vprbench.terminal.help import Command, Option

HIDDEN = "__complete"  # the command that a script asks: the line so far -> what its last word may become

_BASH = f"""\
_vprbench() {{
    local IFS=$'\\n' line="${{COMP_LINE:0:COMP_POINT}}" word
    word="${{line##*[[:space:]]}}"
    COMPREPLY=($("$1" {HIDDEN} "$line" 2>/dev/null))
    [[ ${{#COMPREPLY[@]}} == 1 && ${{COMPREPLY[0]}} == *= ]] && compopt -o nospace
    COMPREPLY=("${{COMPREPLY[@]#"${{word%"${{word##*[=:]}}"}}"}}")  # for bash a word begins after = and :
}}
complete -o default -F _vprbench vprbench
"""
_ZSH = f"""\
#compdef vprbench
_vprbench() {{
    local -a found
    found=(${{(f)"$($words[1] {HIDDEN} "${{(j: :)words[1,CURRENT-1]}} $PREFIX" 2>/dev/null)"}})
    compadd -Q -S '' -- ${{(M)found:#*=}}
    compadd -Q -- ${{found:#*=}}
    (( $#found )) || {{ compset -P '*='; _files }}
}}
compdef _vprbench vprbench
"""
_FISH = f"""\
complete -c vprbench -f -a '(vprbench {HIDDEN} (commandline -cp | string collect) 2>/dev/null)'
"""
SCRIPTS = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}


def candidates(
    line: str,
    commands: Mapping[str, Command],
    options_of: Callable[[Command, Sequence[str]], Iterable[Option]],
    values_of: Callable[[str], Iterable[str]],
) -> list[str]:
    """Return what the last word of a line may become; `values_of` knows the values of an option or of a usage's words.

    What takes several values is completed value by value, after commas.
    """
    *given, word = line.lstrip().split(" ")[1:] or [""]
    given = [each for each in given if each]
    command = commands.get(given[0] if given else "run", commands["run"])
    name, equals, value = word.partition("=")
    options = options_of(command, given)
    if equals:
        head = value[: max(value.rfind(","), value.rfind("[")) + 1]
        known = next((option for option in options if option.name == name), Option(name))
        among, taken = [*values_of(name)] or known.values(), head.strip("[").split(",")
        found = [f"{name}={head}{each}" for each in among if each not in taken]
    else:
        taken = [each.partition("=")[0] for each in given]
        found = [f"{option.name}=" for option in options if option.name not in taken]
        found = [*values_of(command.words), *found] if given else [*commands, *found]
        if not (given or word):  # of a run, what comes first
            found = [*commands, *(f"{group}=" for group in command.groups)]
    return [each for each in found if each.startswith(word)]
