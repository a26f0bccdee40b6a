"""The contract's rules as checks that any method can be put to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from typing import Any, Literal

from vprbench.plugins import networks
from vprbench.plugins.registry import arguments, make_method
from vprbench.plugins.rules import RULES, STORED_RULE, RuleBrokenError


@dataclass(frozen=True)
class Result:
    """What became of one rule."""

    rule: str
    state: Literal["kept", "excepted", "broken"]
    reason: str = ""

    def __str__(self) -> str:
        """Return one line for a person."""
        return f"{self.state:<8}  {self.rule}{': ' + self.reason if self.reason else ''}"


def check(config: Mapping[str, Any], asked: Set[str] = frozenset()) -> Iterator[Result]:
    """Put the method of a configuration to every rule.

    What the method names in `conformance_arguments` replaces its configured arguments, but for those in `asked`.
    A rule that it names in `conformance_exceptions` is not put to it, and its reason is given; neither is the rule on
    stored networks to a method that keeps none. Raises BadInput if a file is missing that the method needs.
    """
    method = make_method(config)
    method.files()
    own = {name: value for name, value in method.conformance_arguments.items() if name not in asked}
    config = {**arguments(config), **own}
    exceptions = dict(method.conformance_exceptions)
    if not networks.keeps_a_network(method):
        exceptions.setdefault(STORED_RULE, "it keeps no network")
    for rule, test in RULES.items():
        if rule in exceptions:
            yield Result(rule, "excepted", exceptions.pop(rule))
            continue
        try:
            test(lambda: make_method(config), config)
        except RuleBrokenError as error:
            yield Result(rule, "broken", str(error))
        except Exception as error:  # whatever a method raises here breaks the rule, and the other rules still count
            yield Result(rule, "broken", f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}")
        else:
            yield Result(rule, "kept")
    for rule in exceptions:
        yield Result(rule, "broken", "conformance_exceptions names a rule that does not exist")
