"""The direct simulation does in each step what Brian2, the authors' simulator, does."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import direct_vprsnn as direct
import numpy as np
import numpy.typing as npt
import pytest
from checkout import ROOT

from vprbench.methods.vprsnn.arguments import Arguments

pytestmark = [
    pytest.mark.extended,
    pytest.mark.skipif(
        importlib.util.find_spec("brian2") is None and not os.environ.get("VPRBENCH_INSIST_ON_BRIAN2"),
        reason="Brian2 is missing: pip install brian2",
    ),
]

SHOWN, LENGTH, SILENCE = 3500, 5000, 5000  # steps of input, of a presentation with its rest, of the silence before all
N_INPUTS, N_NEURONS = 48, 12
WEIGHT_SUM = 22.7  # the largest weights begin close to their limit, 1

Arrays = dict[str, npt.NDArray[np.float64]]


def by_brian2(
    folder: Path, module: Arrays, images: list[npt.NDArray[np.bool_]], weight_sum: float, start: tuple[float, float]
) -> Arrays:
    """Run Brian2 in a process of its own, whose home is an empty folder; a `weight_sum` of 0: nothing is learnt."""
    steps, sources = np.nonzero(np.concatenate([np.pad(image, ((0, LENGTH - SHOWN), (0, 0))) for image in images]))
    potentials = dict(zip(("v", "v_i"), start, strict=True))
    given = {"steps": SILENCE + steps, "sources": sources, "presentations": len(images), "weight_sum": weight_sum}
    np.savez(folder / "given.npz", **module, **potentials, **given)
    script = ROOT / "tests" / "oracles" / "vprsnn_in_brian2.py"
    run = subprocess.run(
        [sys.executable, script, folder / "given.npz", folder / "found.npz"],
        cwd=folder,
        env={**os.environ, "HOME": str(folder), "TMPDIR": str(folder), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return dict(np.load(folder / "found.npz"))


# Hz of each presentation; some neurons that learn are silent for so long that they are not scaled
@pytest.mark.parametrize(
    ("rates", "weight_sum"), [([120, 20, 10, 240, 60], WEIGHT_SUM), ([120, 200, 60], 0)], ids=["learns", "answers"]
)
def test_the_direct_simulation_spikes_step_for_step_as_brian2_and_has_its_weights_and_thresholds(
    tmp_path: Path, rates: list[int], weight_sum: float
) -> None:
    generator = np.random.default_rng(0)
    weights = generator.uniform(0.01, 1, (N_INPUTS, N_NEURONS))
    weights *= WEIGHT_SUM / weights.sum(axis=0)
    delays = generator.integers(0, 101, weights.shape)
    theta = generator.uniform(18, 22, N_NEURONS)
    images = [generator.random((SHOWN, N_INPUTS)) < hz * generator.uniform(0, 2, N_INPUTS) * 1e-4 for hz in rates]
    theirs = by_brian2(
        tmp_path, {"weights": weights, "delays": delays, "theta": theta}, images, weight_sum, (-65.0, -60.0)
    )
    silence = np.zeros((SHOWN, N_INPUTS), np.bool_)
    learning = weight_sum > 0
    ours = direct.simulate(
        weights, delays, theta, [silence, *images], Arguments(), learning, WEIGHT_SUM if learning else None
    )
    for found, group in ((ours.excitatory, "excitatory"), (ours.inhibitory, "inhibitory")):
        assert found.sum() > 50
        np.testing.assert_array_equal(np.argwhere(found), theirs[group][np.lexsort(theirs[group].T[::-1])], group)
    for found, name in ((ours.weights, "weights"), (ours.theta, "theta"), (ours.potentials[-1], "v")):
        np.testing.assert_allclose(found, theirs[name], rtol=0, atol=1e-9)
