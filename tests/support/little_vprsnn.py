"""Small VPRSNN networks: trained on a made-up world, or made by hand with a known input for each neuron."""

from typing import Any

import numpy as np

from vprbench.api.dataset import HeldOut
from vprbench.api.images import Images
from vprbench.methods.vprsnn import model
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.plugins.rules import Journey

SMALL: dict[str, Any] = {"height": 12, "width": 12, "places_per_module": 5, "n_excitatory": 24, "epochs": 6}
WORLD = Journey.draw(0)
STRONG = 50.0  # a weight with which a single spike lifts a neuron from its rest past its threshold


def images(arrays):
    return Images.from_arrays(list(arrays))


def references(n_places, first=0, world=WORLD):
    """Return two images of each of so many places, numbered from 0."""
    rows = np.flatnonzero((world.places >= first) & (world.places < first + n_places))
    return images([world.references[row] for row in rows]), world.places[rows] - first


def held_out(n_places=10, in_map=False):
    """Return places 10 to 19 of the made-up world, or the first of them."""
    shown, places = references(n_places, 10)
    return HeldOut(shown, places, images(WORLD.references[30 : 30 + n_places]), np.arange(n_places), in_map)


def fitted(n_places=5, **arguments):
    return VPRSNN(**{**SMALL, **arguments}).fit(*references(n_places))


def layers(method, codes):
    return {layer.name: np.asarray(layer.values) for layer in method.spikes(codes)}


def recorded_trains(monkeypatch):
    """Return a list to which every train that a network draws is added, as (n_steps, n_inputs)."""
    trains, draw = [], model.draw_spike_train

    def record(levels, generator, intensity, steps, step_ms):
        train = draw(levels, generator, intensity, steps, step_ms)
        spikes = np.zeros((steps, len(levels)), np.bool_)
        spikes[train.step, train.source] = True
        trains.append(spikes)
        return train

    monkeypatch.setattr(model, "draw_spike_train", record)
    return trains


# A network made by hand: `heard[j]` are the inputs that drive neuron j, `spoken_for[j]` the place that it learnt.


def made(heard, spoken_for, n_inputs):
    """Return the arrays of a stored network of one module with all places up to the last that is spoken for."""
    n_neurons, n_places = len(heard), max(spoken_for) + 1
    weights = np.zeros((1, n_inputs, n_neurons))
    sums = np.zeros((1, n_neurons, n_places), np.float32)
    for neuron, (inputs, place) in enumerate(zip(heard, spoken_for, strict=True)):
        weights[0, list(inputs), neuron] = STRONG
        if place >= 0:
            sums[0, neuron, place] = 10
    places, shown = np.arange(n_places)[None], np.full((1, n_places), 10)
    learnt = {"weights": weights, "theta": np.full((1, n_neurons), 20.0), "sums": sums}
    return learnt | {"shown": shown, "places": places, "threshold": np.array(0)}


def lit(n_inputs, *pixels):
    """Return one image a sequence of pixels, which alone are white in it."""
    levels = np.zeros((len(pixels), n_inputs), np.uint8)
    for image, white in enumerate(pixels):
        levels[image, list(white)] = 255
    return levels
