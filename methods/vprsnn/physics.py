"""Constants of VPRSNN's neurons and synapses in the units of the simulation: time steps, millivolts and factors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .arguments import Arguments

_NOTHING = 1e-12  # a trace that would change a weight by less is over


class Physics(NamedTuple):
    """What a compiled loop reads: durations in steps, `_gain` the step over a time constant, `_keep` a step's decay."""

    step_ms: float
    shown: int  # steps of a presentation
    rest: int  # steps of silence after it
    e_rest: float
    e_reset: float
    e_gain: float
    e_refractory: int
    e_threshold: float  # without theta
    e_interval: int  # steps from one spike to the first at which the next may come
    theta_plus: float
    theta_keep: float
    i_rest: float
    i_reset: float
    i_gain: float
    i_refractory: int
    i_threshold: float
    excitation: float  # reversal potential
    e_inhibition: float
    ge_keep: float
    gi_keep: float
    e_to_i: float
    i_to_e: float
    slow_post_tau: float  # ms
    post_rate: float
    weight_max: float
    nothing: float  # a conductance below this moves no potential


class Traces(NamedTuple):
    """The traces of plasticity by the steps since their last event, until they are nothing."""

    pre: npt.NDArray[np.float64]
    post: npt.NDArray[np.float64]  # times the rate of learning at a presynaptic spike


def count_steps(milliseconds: float, step_ms: float) -> int:
    """Return the whole number of steps nearest to a duration."""
    return math.floor(milliseconds / step_ms + 0.5)


def make_physics(arguments: Arguments) -> Physics:
    """Return the constants that arguments give, in steps and factors.

    Source: VPRSNN (QVPR/VPRSNN), whose forward Euler steps give the decay factors 1 - step / time constant.
    """
    step = arguments.time_step_ms
    refractory = count_steps(arguments.excitatory_refractory_ms, step)
    return Physics(
        step_ms=step,
        shown=count_steps(arguments.presentation_ms, step),
        rest=count_steps(arguments.rest_ms, step),
        e_rest=float(arguments.excitatory_rest_mv),
        e_reset=float(arguments.excitatory_reset_mv),
        e_gain=step / arguments.excitatory_tau_ms,
        e_refractory=refractory,
        e_threshold=float(arguments.excitatory_threshold_mv),
        e_interval=max(_count_interval_steps(arguments.excitatory_minimum_interval_ms, step), refractory),
        theta_plus=float(arguments.theta_plus_mv),
        theta_keep=1 - step / arguments.theta_tau_ms,
        i_rest=float(arguments.inhibitory_rest_mv),
        i_reset=float(arguments.inhibitory_reset_mv),
        i_gain=step / arguments.inhibitory_tau_ms,
        i_refractory=count_steps(arguments.inhibitory_refractory_ms, step),
        i_threshold=float(arguments.inhibitory_threshold_mv),
        excitation=float(arguments.excitation_reversal_mv),
        e_inhibition=float(arguments.excitatory_inhibition_reversal_mv),
        ge_keep=1 - step / arguments.excitation_tau_ms,
        gi_keep=1 - step / arguments.inhibition_tau_ms,
        e_to_i=float(arguments.excitatory_to_inhibitory_weight),
        i_to_e=float(arguments.inhibitory_to_excitatory_weight),
        slow_post_tau=float(arguments.slow_post_trace_tau_ms),
        post_rate=float(arguments.post_rate),
        weight_max=float(arguments.weight_max),
        nothing=1e-15,
    )


def make_traces(arguments: Arguments) -> Traces:
    """Return the traces that a spike leaves, step by step until they change no weight."""
    return Traces(
        _list_decay(arguments.pre_trace_tau_ms, arguments.time_step_ms, 1.0),
        _list_decay(arguments.post_trace_tau_ms, arguments.time_step_ms, arguments.pre_rate),
    )


def _count_interval_steps(minimum_ms: float, step_ms: float) -> int:
    """Return the steps until the timer, which grows by a tenth of the time, is past a tenth of the minimum interval.

    The timer is a sum of steps in seconds, and whether its rounding reaches the limit decides about one step.
    """
    limit, grown, timer, count = 0.1 * minimum_ms / 1000, 0.1 * step_ms / 1000, 0.0, 0
    while timer <= limit:
        timer += grown
        count += 1
    return count


def _list_decay(tau_ms: float, step_ms: float, start: float) -> npt.NDArray[np.float64]:
    length = max(1, math.ceil(tau_ms / step_ms * math.log(abs(start) / _NOTHING))) if start else 1
    decay: npt.NDArray[np.float64] = start * np.exp(-np.arange(length) * (step_ms / tau_ms))
    return decay
