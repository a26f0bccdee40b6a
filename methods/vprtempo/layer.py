"""One layer of VPRTempo, all modules at once: its initial weights, its activation and one learning step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from vprbench.api import compiled as compiled_exactly

from .rules import Rules

#: Compiles inner loops. Sums may be reordered; infinities still count.
compiled = compiled_exactly(fastmath={"reassoc", "contract", "arcp", "nsz"})

# Limits of a weight's magnitude; kernels are cached with them, so a change has to touch `fused_kernels.py` too.
SMALLEST, LARGEST = 1e-6, 10.0
# Stands for a synapse that exists with weight 0, until the next limit lifts it: 0 is a synapse that does not exist.
NEARLY_NOTHING = 1e-30


@dataclass
class Layer:
    """Excitatory and inhibitory weights as magnitudes, with thresholds; every first axis is the module.

    A synapse that does not exist weighs 0, one that exists more.
    """

    excitation: Tensor  # (modules, n_post, n_pre)
    inhibition: Tensor  # (modules, n_post, n_pre)
    thresholds: Tensor  # (modules, n_post)
    constant: Tensor  # (modules, n_post)

    def __getitem__(self, modules: slice) -> Layer:
        """Return some modules as a view: learning in it is learning here."""
        return self._with_parts(lambda part: part[modules])

    def to(self, device: str) -> Layer:
        """Return the layer on another device."""
        return self._with_parts(lambda part: part.to(device))

    def _with_parts(self, change: Callable[[Tensor], Tensor]) -> Layer:
        return Layer(*map(change, vars(self).values()))

    @property
    def weights(self) -> Tensor:
        """The signed weights, (modules, n_post, n_pre)."""
        return self.excitation - self.inhibition

    def net_input(self, x: Tensor) -> Tensor:
        """Return the net input (modules, n_post) of one input per module (modules, n_pre), C included."""
        column = x[:, :, None]
        return (torch.bmm(self.excitation, column) - torch.bmm(self.inhibition, column))[:, :, 0] + self.constant

    def spikes(self, net_input: Tensor, clip: float) -> Tensor:
        """Return the activation of Eq. 1, the net input above threshold, from 0 to `clip`."""
        return (net_input - self.thresholds).clamp_(0, clip)


def learn_features(layer: Layer, x: Tensor, rates: Tensor, stdp: Tensor, itp: Tensor, rules: Rules) -> None:
    """Do one step of spike-timing dependent plasticity (Eqs. 2, 4 and 5) in place.

    `x` (modules, n_pre) holds one image per module, `rates` (n_post,) the target firing rates, `stdp` and `itp`
    (modules, 1) the learning rates now.
    """
    net = layer.net_input(x)
    y = layer.spikes(net, rules.clip)
    fired = y > 0
    post = stdp * (0.5 - y) * fired
    if rules.stdp_divided_by_rate:
        post /= rates
    change = post[:, :, None] * (x > 0)[:, None, :]
    _change_synapses(layer.excitation, change)
    _change_synapses(layer.inhibition, change)
    if rules.threshold_rule == "spike":
        layer.thresholds += itp * (fired.to(x.dtype) - rates)
    elif rules.threshold_rule == "amplitude":
        layer.thresholds += itp * (y - rates)
    else:
        layer.thresholds -= itp * rates
    layer.thresholds.clamp_(min=0)
    _balance(layer, net, stdp, rules)


def learn_places(layer: Layer, x: Tensor, target: Tensor, pre_rates: Tensor, stdp: Tensor, rules: Rules) -> None:
    """Do one step of spike forcing (Eq. 6) and homeostasis (Eq. 4) in place.

    `x` (modules, n_pre) holds the feature spikes of one image per module, `target` (modules,) the output neuron
    that is forced to 0.5, `pre_rates` (n_pre,) the target rates of the feature neurons, `stdp` (modules, 1).
    """
    net = layer.net_input(x)
    error = -layer.spikes(net, rules.clip)
    error[torch.arange(len(target), device=target.device), target] += 0.5
    if rules.output_thresholds_learn:
        layer.thresholds.sub_(error.sign() * stdp / 5).clamp_(min=0)
    share = 1.0 if rules.error_to_each_sign else 0.5
    change = (share * stdp * error)[:, :, None] * (x / pre_rates)[:, None, :]
    _change_synapses(layer.excitation, change)
    _change_synapses(layer.inhibition, -change)
    _balance(layer, net, stdp, rules)


def _change_synapses(weights: Tensor, change: Tensor) -> None:
    """Add a change to the synapses that exist, and keep every weight's sign and size."""
    weights.copy_(torch.where(weights != 0, (weights + change).clamp_(SMALLEST, LARGEST), 0.0))


def _balance(layer: Layer, net_input: Tensor, stdp: Tensor, rules: Rules) -> None:
    """Scale the inhibition with the neuron's own net input (homeostasis)."""
    # A factor below 0 (a net input under -4) would flip signs; the next step lifts the smallest weights again.
    layer.inhibition.mul_((1 + rules.homeostasis_gain * stdp * net_input).clamp_(min=NEARLY_NOTHING)[:, :, None])


def ramp_rates(n: int, lowest: float, highest: float) -> Tensor:
    """Return the fixed ramp of target firing rates, (n,), from just above `lowest` to `highest`."""
    return (lowest + (highest - lowest) * torch.arange(1, n + 1, dtype=torch.float64) / n).float()


def draw_layer(
    generators: Sequence[torch.Generator],
    n_post: Sequence[int],
    n_pre: int,
    probabilities: tuple[float, float],
    threshold_max: float,
    constant_max: float,
    rules: Rules,
) -> Layer:
    """Draw a layer's initial state, one generator and one size per module; smaller modules are padded with nothing.

    `probabilities` are the shares of excitatory and of inhibitory connections. A module's draws do not depend on
    the other modules.
    """
    modules = [
        _draw_module(generator, size, n_pre, probabilities, rules)
        for generator, size in zip(generators, n_post, strict=True)
    ]
    # Padding counts as synapses that exist where all do, for kernels then read no masks.
    weight = 0.0 if rules.one_sign_per_synapse else NEARLY_NOTHING
    excitation, inhibition, thresholds, constant = (
        modules[0][part][None]
        if len(modules) == 1
        else pad_sequence([module[part] for module in modules], batch_first=True, padding_value=value)
        for part, value in enumerate((weight, weight, 0.0, 0.0))
    )
    return Layer(excitation, inhibition, threshold_max * thresholds, constant_max * constant)


def _draw_module(
    generator: torch.Generator, n_post: int, n_pre: int, probabilities: tuple[float, float], rules: Rules
) -> tuple[Tensor, ...]:
    """Return excitation, inhibition, (n_post, n_pre), thresholds and constant input (n_post,), each from 0 to 1."""
    thresholds, constant = (torch.rand(n_post, generator=generator) for _ in range(2))
    excitation, inhibition = (_draw_synapses(generator, n_post, n_pre, each, rules) for each in probabilities)
    if rules.one_sign_per_synapse:
        signed = excitation - inhibition
        excitation, inhibition = signed.clamp(min=0), (-signed).clamp_(min=0)
    return excitation, inhibition, thresholds, constant


def _draw_synapses(generator: torch.Generator, n_post: int, n_pre: int, probability: float, rules: Rules) -> Tensor:
    """Return the magnitudes of the synapses of one sign, (n_post, n_pre)."""
    magnitude = torch.randn(n_post, n_pre, generator=generator)
    exists = _draw_connections(generator, n_post, n_pre, probability, rules)
    if not exists.any():
        return magnitude.zero_()
    magnitude.div_(6).add_(0.5).clamp_(min=0).mul_(exists)
    norm = magnitude.sum(1, keepdim=True)
    divisor = norm[-1:] if rules.normalise_by_last_neuron else norm
    magnitude.div_(torch.where(divisor == 0, 1.0, divisor))
    if not rules.one_sign_per_synapse:  # where a synapse drawn as 0 does not exist
        magnitude.masked_fill_(exists & (magnitude == 0), NEARLY_NOTHING)
    return magnitude


def _draw_connections(generator: torch.Generator, n_post: int, n_pre: int, probability: float, rules: Rules) -> Tensor:
    """Return which synapses exist, (n_post, n_pre)."""
    if not rules.even_connections or probability == 0:
        return torch.rand(n_post, n_pre, generator=generator) < probability
    each = max(1, round(probability * n_pre))
    rounds = -(-n_post * each // n_pre)
    inputs = torch.cat([torch.randperm(n_pre, generator=generator) for _ in range(rounds)])[: n_post * each]
    return torch.zeros(n_post, n_pre, dtype=torch.bool).scatter_(1, inputs.view(n_post, each), True)
