"""The convolutions of VGG16, numbered as the published weights are."""

from __future__ import annotations

from torch import nn

N_CHANNELS = 512

_GROUPS = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))  # channels, convolutions; a pool ends each group


def vgg16_features(n_layers: int = 31) -> nn.Sequential:
    """Return the first layers of VGG16's `features`, in evaluation mode and without gradients.

    The keys are "0.weight", "0.bias", "2.weight" and so on: every convolution, ReLU and pool has a number. With 31
    layers images (n, 3, height, width) become (n, 512, height // 32, width // 32). With 29 they end after conv5_3,
    before its ReLU and the last pool: (n, 512, height // 16, width // 16).
    Source: Simonyan and Zisserman 2015, configuration D, in torchvision's numbering.
    """
    layers: list[nn.Module] = []
    n_inputs = 3
    for n_channels, n_convolutions in _GROUPS:
        for _ in range(n_convolutions):
            layers += [nn.Conv2d(n_inputs, n_channels, 3, padding=1), nn.ReLU(inplace=True)]
            n_inputs = n_channels
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers[:n_layers]).eval().requires_grad_(False)
