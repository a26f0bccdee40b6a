"""DenseVLAD once more, slowly, in double precision, written from the specification alone."""

import math

import numpy as np
from scipy.ndimage import convolve1d
from scipy.spatial.distance import cdist
from sklearn.preprocessing import normalize

SIZES = (4, 6, 8, 10)


def filtered(image, kernel):
    """Convolve both sides with a symmetric kernel; beyond its borders an image goes on unchanged."""
    return convolve1d(convolve1d(image, kernel, 1, mode="nearest"), kernel, 0, mode="nearest")


def vlfeat_atan2(y, x):
    """VLFeat's vl_fast_atan2_f."""
    above = abs(y) + 2**-23
    ratio, turned = ((x - above) / (x + above), 1) if x >= 0 else ((x + above) / (above - x), 3)
    angle = turned * math.pi / 4 + 0.1821 * ratio**3 - 0.9675 * ratio
    return -angle if y < 0 else angle


def orientation_maps(image, arctan=math.atan2):
    down, right = np.gradient(image)  # one-sided at the borders
    turn = np.vectorize(arctan)(down, right) / (2 * math.pi) * 8 % 8
    apart = np.abs(turn - np.arange(8)[:, None, None])  # from each orientation, round the circle
    return np.maximum(0, 1 - np.minimum(apart, 8 - apart)) * np.hypot(down, right)


def window(size, number):
    """The mean of a Gaussian of 1.5 bins over the pixels of a bin, 0 to 3, along one side."""
    centre = size * (number - 1.5)
    return np.mean([math.exp(-0.5 * ((t - centre) / (1.5 * size)) ** 2) for t in range(1 - size, size)])


def dense_sift(image, arctan=math.atan2):
    """Return for each scale the unit descriptors, (n, 128), of a grey image from 0 to 1; zero where contrast is low."""
    scales = []
    for size in SIZES:
        sigma = size / 6
        reach = math.ceil(4 * sigma)
        gaussian = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        smooth = filtered(np.asarray(image, np.float64), gaussian / gaussian.sum())
        triangle = 1 - np.abs(np.arange(-size, size + 1)) / size
        summed = [filtered(one, triangle) for one in orientation_maps(smooth, arctan)]
        first = math.floor(1 + 3 / 2 * (10 - size)) - 1  # the specification counts from 1
        frame = 3 * size + 1
        weights = np.array([window(size, number) for number in range(4)])
        bins = np.stack(summed, 2)  # (height, width, 8)
        descriptors = [
            (bins[top : top + frame : size, left : left + frame : size] * np.outer(weights, weights)[..., None]).ravel()
            for top in range(first, image.shape[0] - frame + 1, 2)
            for left in range(first, image.shape[1] - frame + 1, 2)
        ]
        scales.append(np.array([normalised(one, frame) for one in descriptors]).reshape(-1, 128))
    return scales


def normalised(histogram, frame):
    if histogram.sum() / frame**2 < 0.005:
        return np.zeros(128)
    unit = np.minimum(histogram / np.linalg.norm(histogram), 0.2)
    return unit / np.linalg.norm(unit)


def root_sift(descriptor):
    levels = np.floor(np.minimum(512 * descriptor, 255))
    return np.sqrt(levels / (levels.sum() + 1e-12))


def vlad(descriptors, words, word_of_zero=0):
    values = np.array(descriptors)
    nearest = np.where(values.any(1), cdist(values, words).argmin(1), word_of_zero)
    sums = np.stack([(values[nearest == number] - word).sum(0) for number, word in enumerate(words)])
    return normalize(normalize(sums).reshape(1, -1))[0]
