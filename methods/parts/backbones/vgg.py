"""The convolutions of VGG16, numbered as the published weights are."""

from __future__ import annotations

from torch import nn

from vprbench.api import BadInput

N_CHANNELS = 512
N_LAYERS = 31  # convolutions, ReLUs and pools

_GROUPS = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))  # channels, convolutions; a pool ends each group


def vgg16_features(n_layers: int = N_LAYERS) -> nn.Sequential:
    """Return the first layers of VGG16's `features`, in evaluation mode and without gradients.

    The keys are "0.weight", "0.bias", "2.weight" and so on: every convolution, ReLU and pool has a number. With 31
    layers images (n, 3, height, width) become (n, 512, height // 32, width // 32). With 29 they end after conv5_3,
    before its ReLU and the last pool: (n, 512, height // 16, width // 16). Raises BadInput outside 1 to 31.
    Source: Simonyan and Zisserman 2015, configuration D, in torchvision's numbering.
    """
    if not 1 <= n_layers <= N_LAYERS:
        raise BadInput(f"n_layers={n_layers}: VGG16 has layers 1 to {N_LAYERS}")
    layers: list[nn.Module] = []
    n_inputs = 3
    for n_channels, n_convolutions in _GROUPS:
        for _ in range(n_convolutions):
            layers += [nn.Conv2d(n_inputs, n_channels, 3, padding=1), nn.ReLU(inplace=True)]
            n_inputs = n_channels
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers[:n_layers]).eval().requires_grad_(False)
