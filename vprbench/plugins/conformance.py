"""The contract's rules as checks that any method or dataset can be put to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from vprbench.errors import BadInput
from vprbench.plugins import networks
from vprbench.plugins.dataset_rules import DATASET_RULES, BuiltDataset
from vprbench.plugins.local_plugins import describe_error
from vprbench.plugins.opened_files import listening, unnamed_files
from vprbench.plugins.registry import arguments, entries, make_dataset, make_method, near
from vprbench.plugins.rules import (
    ENCODE_RULE,
    EXTENDED_RULE,
    RULES,
    STORED_RULE,
    RuleBrokenError,
    RuleExceptedError,
    Subject,
)
from vprbench.plugins.tuned_places import UNKNOWN, declared_places, stretches
from vprbench.text import some


@dataclass(frozen=True)
class Result:
    """What became of one rule."""

    rule: str
    state: Literal["kept", "excepted", "broken"]
    reason: str = ""

    def __str__(self) -> str:
        """Return one line for a person."""
        return f"{self.state:<8}  {self.rule}{': ' + self.reason if self.reason else ''}"


FILES_RULE = "files() names the files that it reads"
TUNED_RULE = "tuned_on names datasets and numbers of their places"


def check(config: Mapping[str, Any], given: Set[str] = frozenset()) -> Iterator[Result]:
    """Put the method of a configuration to every rule.

    What the method names in `conformance_arguments` replaces its configured arguments, but for those in `given`.
    A rule that it names in `conformance_exceptions` is not put to it, and its reason is given; neither is the rule on
    stored networks to a method that keeps none, nor that on growing maps to a method that does not extend. Where `fit`
    or `encode` fails there are no codes, and the other rules are not put to it: each would say the same. A declared
    `tuned_on` is looked at too. Raises BadInput if a file is missing that the method needs.
    """
    if config.get("tuned_on") is not None:
        yield _result(TUNED_RULE, partial(_declared, config["tuned_on"]))
    method = make_method(config)
    method.files()
    own = {name: value for name, value in method.conformance_arguments.items() if name not in given}
    config = {**arguments(config), **own}
    exceptions = dict(method.conformance_exceptions)
    if not networks.keeps_a_network(method):
        exceptions.setdefault(STORED_RULE, "it keeps no network")
    subject = Subject(partial(make_method, config), config)
    with listening() as opened:
        for rule, test in RULES.items():
            if rule in exceptions:
                yield Result(rule, "excepted", exceptions.pop(rule))
            elif rule != EXTENDED_RULE or method.extends:
                result = _result(rule, partial(test, subject))
                yield result
                if rule == ENCODE_RULE and result.state == "broken":
                    return
    if unnamed := unnamed_files(opened, method):
        yield Result(
            FILES_RULE,
            "broken",
            f"it reads {some(unnamed)}: return it from files(), or runs are found again whatever it holds",
        )
    for rule in exceptions:
        yield Result(rule, "broken", "conformance_exceptions names a rule that does not exist")


def check_dataset(config: Mapping[str, Any]) -> Iterator[Result]:
    """Put the dataset of a configuration to every rule; of its images some are read.

    Raises BadInput where it cannot be made, as for frames that are missing.
    """
    made = BuiltDataset(make_dataset(config), partial(make_dataset, config), config)
    for rule, test in DATASET_RULES.items():
        yield _result(rule, partial(test, made))


def _declared(tuned_on: Any) -> None:
    """Raise RuleBrokenError for a `tuned_on` by which nobody can tell which queries show its places."""
    declared = declared_places(tuned_on, "its yaml")
    known = [str(entry.values().get("name", name)) for name, entry in entries("dataset").items()]
    for name, places in {**declared["also_in"], declared["dataset"]: declared["places"]}.items():
        if name not in known:
            raise RuleBrokenError(f"dataset {name} is unknown: {near(name, known)}")
        if stretches(places) is None and (places != UNKNOWN or name == declared["dataset"]):
            raise RuleBrokenError(f"places of {name}: {places} came, wanted their numbers, as in 0-99,200-299")


def _result(rule: str, test: Callable[[], None]) -> Result:
    """Return what becomes of a rule; whatever a plug-in raises breaks it, and the other rules still count."""
    try:
        test()
    except RuleExceptedError as error:
        return Result(rule, "excepted", str(error))
    except (RuleBrokenError, BadInput) as error:
        return Result(rule, "broken", str(error))
    except Exception as error:
        return Result(rule, "broken", describe_error(error))
    return Result(rule, "kept")
