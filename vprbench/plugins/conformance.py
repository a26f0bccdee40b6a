"""The rules of the contract, put to any method or dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from vprbench.errors import BadInput
from vprbench.plugins.dataset_rules import DATASET_RULES, BuiltDataset
from vprbench.plugins.registry import check_arguments, describe_error, make_dataset, make_method, take_arguments
from vprbench.plugins.rules import ENCODE_RULE, RULES, RuleBrokenError, Subject


@dataclass(frozen=True)
class Result:
    """The outcome of one rule."""

    rule: str
    state: Literal["kept", "excepted", "broken"]
    reason: str = ""

    def __str__(self) -> str:
        """Return one line for a person."""
        return f"{self.state:<8}  {self.rule}{': ' + self.reason if self.reason else ''}"


def check_method(config: Mapping[str, Any], given: Set[str] = frozenset()) -> Iterator[Result]:
    """Put the method of a configuration to every rule; a first fit or encode that fails ends the rules.

    Args:
        config: `_target_` and arguments of the method.
        given: names of arguments that the method's `conformance_arguments` do not replace.

    Raises:
        BadInput: a file is missing that the method needs.
    """
    method = make_method(config)
    method.files()
    own = {name: value for name, value in method.conformance_arguments.items() if name not in given}
    config = {**take_arguments(config), **own}
    subject = Subject(partial(make_method, config), check_arguments("method", config)[1])
    exceptions = dict(method.conformance_exceptions)
    for name, rule in RULES.items():
        if name in exceptions:
            yield Result(name, "excepted", exceptions.pop(name))
            continue
        result = _apply_rule(name, partial(rule.check, subject), partial(rule.excuse, subject))
        yield result
        if name == ENCODE_RULE and result.state == "broken":
            return
    for name in exceptions:
        yield Result(name, "broken", "conformance_exceptions names a rule that does not exist")


def check_dataset(config: Mapping[str, Any]) -> Iterator[Result]:
    """Put the dataset of a configuration to every rule; some of its images are read.

    Raises BadInput where it cannot be made, as for frames that are missing.
    """
    built = BuiltDataset(make_dataset(config), partial(make_dataset, config))
    for rule, test in DATASET_RULES.items():
        yield _apply_rule(rule, partial(test, built))


def _apply_rule(rule: str, test: Callable[[], None], excuse: Callable[[], str] = str) -> Result:
    """Return the outcome of a rule; any error of a plug-in breaks that rule alone."""
    try:
        if reason := excuse():
            return Result(rule, "excepted", reason)
        test()
    except Exception as error:
        explained = isinstance(error, RuleBrokenError | BadInput)
        return Result(rule, "broken", str(error) if explained else describe_error(error))
    return Result(rule, "kept")
