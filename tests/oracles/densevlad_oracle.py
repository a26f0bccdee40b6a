"""DenseVLAD once more, slowly: plain loops in double precision, written from the specification alone."""

from __future__ import annotations

import math

import numpy as np

SIZES = (4, 6, 8, 10)


def at(line, i):
    return line[min(max(i, 0), len(line) - 1)]


def filtered(line, kernel, reach):
    """Convolve a line with a symmetric kernel; beyond the ends it goes on unchanged."""
    return [sum(kernel(t) * at(line, i + t) for t in range(-reach, reach + 1)) for i in range(len(line))]


def filtered_image(image, kernel, reach):
    rows = np.array([filtered(row, kernel, reach) for row in image])
    return np.array([filtered(column, kernel, reach) for column in rows.T]).T


def slope(line, i):
    if i == 0:
        return line[1] - line[0]
    if i == len(line) - 1:
        return line[i] - line[i - 1]
    return (line[i + 1] - line[i - 1]) / 2


def vlfeat_atan2(y, x):
    """VLFeat's vl_fast_atan2_f."""
    above = abs(y) + 2**-23
    ratio, turned = ((x - above) / (x + above), 1) if x >= 0 else ((x + above) / (above - x), 3)
    angle = turned * math.pi / 4 + 0.1821 * ratio**3 - 0.9675 * ratio
    return -angle if y < 0 else angle


def orientation_maps(image, arctan=math.atan2):
    maps = np.zeros((8, *image.shape))
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            down, right = slope(image[:, x], y), slope(image[y], x)
            turn = arctan(down, right) / (2 * math.pi) * 8 % 8
            lower = math.floor(turn)
            maps[lower % 8, y, x] += (1 - (turn - lower)) * math.hypot(down, right)
            maps[(lower + 1) % 8, y, x] += (turn - lower) * math.hypot(down, right)
    return maps


def window(size, number):
    """The mean of a Gaussian of 1.5 bins over the pixels of a bin, 0 to 3, along one side."""
    centre = size * (number - 1.5)
    return np.mean([math.exp(-0.5 * ((t - centre) / (1.5 * size)) ** 2) for t in range(1 - size, size)])


def dense_sift(image, arctan=math.atan2):
    """Return for each scale the unit descriptors, (n, 128), of a grey image from 0 to 1; zero where contrast is low."""
    image = np.asarray(image, np.float64)
    scales = []
    for size in SIZES:
        sigma = size / 6
        reach = math.ceil(4 * sigma)
        total = sum(math.exp(-0.5 * (t / sigma) ** 2) for t in range(-reach, reach + 1))
        smooth = filtered_image(image, lambda t, s=sigma, z=total: math.exp(-0.5 * (t / s) ** 2) / z, reach)
        summed = [
            filtered_image(one, lambda t, n=size: max(0, 1 - abs(t) / n), size)
            for one in orientation_maps(smooth, arctan)
        ]
        first = math.floor(1 + 3 / 2 * (10 - size)) - 1  # the specification counts from 1
        frame = 3 * size + 1
        descriptors = []
        for top in range(first, image.shape[0] - frame + 1, 2):
            for left in range(first, image.shape[1] - frame + 1, 2):
                histogram = []
                for by in range(4):
                    for bx in range(4):
                        weight = window(size, by) * window(size, bx)
                        histogram += [weight * summed[t][top + by * size, left + bx * size] for t in range(8)]
                descriptors.append(normalised(np.array(histogram), frame))
        scales.append(np.array(descriptors).reshape(-1, 128))
    return scales


def normalised(histogram, frame):
    if histogram.sum() / frame**2 < 0.005:
        return np.zeros(128)
    unit = np.minimum(histogram / np.linalg.norm(histogram), 0.2)
    return unit / np.linalg.norm(unit)


def root_sift(descriptor):
    levels = np.array([math.floor(min(512 * value, 255)) for value in descriptor])
    return np.sqrt(levels / (levels.sum() + 1e-12))


def vlad(descriptors, words, word_of_zero=0):
    sums = np.zeros(words.shape)
    for descriptor in descriptors:
        distances = [np.sum((descriptor - word) ** 2) for word in words]
        nearest = word_of_zero if not descriptor.any() else int(np.argmin(distances))
        sums[nearest] += descriptor - words[nearest]
    laid_out = []
    for residual in sums:
        norm = np.linalg.norm(residual)
        laid_out += list(residual / norm if norm > 0 else residual)
    return np.array(laid_out) / np.linalg.norm(laid_out)
