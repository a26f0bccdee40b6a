"""Arguments that a map needs in place of a method's own, where nobody has set them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from vprbench.api.method import Method
from vprbench.errors import BadInput


def adaptation(method: Method, n_places: int, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments that a run's method takes for a map of so many places in place of its own.

    `config` is that of the run. Raises BadInput if one of these arguments was set by hand to what does not fit.
    """
    needed = dict(method.adapted(n_places))
    for name in needed.keys() & _set_by_hand(config):
        value, fitting = (json.dumps(of[name]) for of in (config["method"], needed))
        raise BadInput(
            f"method.{name}={value} does not fit a map of {n_places:,} places: "
            f"give method.{name}={fitting}, or leave it out"
        )
    return needed


def adapted_as(stored: Mapping[str, Any], config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the configuration of a run as it would be if it were adapted as a `stored` one was."""
    by_hand = _set_by_hand(config)
    needed = {name: value for name, value in stored.get("adapted", {}).items() if name not in by_hand}
    return {**config, "method": {**config["method"], **needed}}


def describe_adaptation(config: Mapping[str, Any], n_places: int) -> Iterator[str]:
    """Yield what a reader of a run has to know of each argument that was adapted."""
    for name, value in config.get("adapted", {}).items():
        yield f"adapted to a map of {n_places:,} places: method.{name}={json.dumps(value)} in place of its own"


def _set_by_hand(config: Mapping[str, Any]) -> set[str]:
    named = (option.lstrip("+").partition("=")[0] for option in config.get("overrides", ()))
    return {*config.get("changed", ()), *(name.removeprefix("method.") for name in named if name.startswith("method."))}
