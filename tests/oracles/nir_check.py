"""Ask stored VPRTempo networks in other simulators: `nir_check.py PYTHON [QUERIES]`; code 1 if one differs."""

import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import nir
import nir_simulators as simulators
import numpy as np

from vprbench.datasets.nordland import nordland
from vprbench.datasets.synthetic import synthetic
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import networks

WANTED = {"spiking": 0.99, "linear": 1.0}  # shares of queries with the same best place
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "nordland_64x32"
WRONG = {"reset to 0": {"reset": "zero"}, "leak of 0.9": {"kept": 0.9}}


def journey(n_queries):
    """Return 1000 places of Nordland where its frames lie beside the checkout, else of the rendered journey."""
    places = {"places": 1000, "query_places": n_queries, "first_query_place": 0}
    own = {"name": "nordland_64x32", "references": ["winter"], "stride": 1, "frame_multiple": 10}
    return nordland(root=str(REAL), **own, **places) if REAL.is_dir() else synthetic(**places)


def main(python, n_queries=1000):
    """Print a line for each network and simulator; return whether all agree."""
    dataset, fine = journey(n_queries), True
    trained = VPRTempo(max_module=500).fit(dataset.references, dataset.places)
    inputs = trained.encode(dataset.queries)
    print(f"{dataset.name}: {dataset.n_places} places, {len(inputs)} queries")
    for rule, wanted in WANTED.items():
        method = VPRTempo(max_module=500, query_rule=rule).restore(trained.state())
        own = method.match(inputs)
        with TemporaryDirectory() as folder:
            net = Path(folder) / f"{rule}.nir"
            arguments = {name: value for name, value in vars(method).items() if not name.startswith("_")}
            origin = networks.describe_origin(method, arguments, dataset)
            networks.save_network(networks.Files(save=net), method, origin, dataset.references)
            graph = nir.read(net)
            in_brian2 = partial(simulators.in_brian2, python, net, Path(folder))
            ways = {"plain": simulators.plain, "snnTorch": simulators.in_snntorch, "Brian2": in_brian2}
            if rule == "spiking":
                others = {f"plain, {n} steps": {"steps": n} for n in (8, 16, 32, 128)} | WRONG
                ways |= {name: partial(simulators.plain, **how) for name, how in others.items()}
            for name, simulate in ways.items():
                answers = simulators.scores(graph, simulate, inputs)
                same = float((answers.argmax(1) == own.argmax(1)).mean())
                known = simulators.knows_the_neurons(graph, simulate)
                print(
                    f"{rule:8} {name:18} same best place {100 * same:6.2f} %, largest difference of scores "
                    f"{np.abs(answers - own).max():.1e}, check vector {'answered' if known else 'missed'}"
                )
                fine &= "steps" in name or (not known if name in WRONG else known and same >= wanted)
    print("all agree" if fine else "NOT all agree: only a wrong neuron has to miss the check vector")
    return fine


if __name__ == "__main__":
    sys.exit(not main(Path(sys.argv[1]), *map(int, sys.argv[2:3])))
