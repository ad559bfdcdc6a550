"""From two meshes to a film with the library alone: what the commands of nsm do, one step after another.

    python tools/two_meshes_to_film.py a.obj b.ply film.mp4

Both meshes are scaled to one volume, f and V are trained, and the morph is measured and filmed. Beside the film go the
volume over time (.csv, .png) and all figures of merit (.json). The sizes below are those of the default configuration;
`--help` lists what makes it shorter.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import nsm  # isort: skip  # noqa: F401 (before torch: it settles how threads wait for each other)
import lightning as L
import torch
from pytorch_optimizer import SOAP

from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.fields import AdaDiv, Gaussian, ScalarSiren, VectorSiren
from nsm.losses import AmbientDirichlet, Eikonal, EndVolume, LevelSet, NormalAlignment, SurfaceDirichlet, WeightedSum
from nsm.metrics import Protocol, evaluate_morph
from nsm.morphs.neural import NeuralMorph
from nsm.plots.curves import plot_volume_curves, write_volume_curve
from nsm.plots.look import Look
from nsm.render.film import Pace, render_film
from nsm.sampling import Box, EndSurfaces, Fractions, MorphSampler, MovingSurface, UniformTime
from nsm.shapes import FieldShape, MeshFile, equal_volume, place_together
from nsm.train.callbacks import Progress
from nsm.train.tasks import FieldData, MorphTask, draw_pools, warmup_cosine

#: Space is three-dimensional; the shapes lie in [-1, 1]^3, and the equations are asked for a little beyond.
DIM, HALF_WIDTH = 3, 1.5
#: Points on and around each shape whose targets are computed once.
POOL = 200_000
#: How a batch is divided: on the end shapes, around them, and the rest inside space-time.
PARTS = Fractions(surface=0.25, ambient=0.25)


def main() -> None:
    """Scale, train, measure, film."""
    sizes = read_arguments()
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    torch.manual_seed(0)
    scaled = equal_volume(MeshFile(sizes.source), MeshFile(sizes.target))
    pair = place_together(scaled.source, scaled.target)
    morph = train(pair.source, pair.target, sizes)
    measure(morph, sizes)
    film(morph, sizes)


def train(source: FieldShape, target: FieldShape, sizes: argparse.Namespace) -> NeuralMorph:
    """f(x, t) and V(x, t) together: V = curl D + β(f) ∇u carries f from the source to the target."""
    field = ScalarSiren(DIM + 1, sizes.width, sizes.layers, omega=30.0, first_omega=5.0)
    potentials = partial(VectorSiren, hidden_features=96, hidden_layers=4, omega=20.0, first_omega=10.0)
    morph = NeuralMorph(field, AdaDiv(DIM, potentials, Gaussian(alpha=0.1)), source, target)
    loss = WeightedSum(
        {
            "level_set": LevelSet(4e3),
            "dirichlet": AmbientDirichlet(5e3),
            "surface": SurfaceDirichlet(5e3),
            "volume": EndVolume(3e4),
            "neumann": NormalAlignment(200, power=1),
            "eikonal": Eikonal(100),
        }
    )
    box = Box(DIM, HALF_WIDTH)
    pools = draw_pools(source, POOL, 0, HALF_WIDTH), draw_pools(target, POOL, 1, HALF_WIDTH)
    sampler = partial(MorphSampler, *pools, box, UniformTime())
    data = FieldData(sampler(sizes.points, PARTS), sampler(8000, Fractions(surface=1.0, ambient=0.0)), seed=0)
    _, ambient, interior = PARTS.counts(sizes.points)
    near = MovingSurface(DIM, interior, fraction=0.3, width=0.08, reach=0.25)
    at_ends = EndSurfaces(DIM, ambient, own=0.5, visitors=0.25, width=0.03, reach=0.1)
    task = MorphTask(morph, near, at_ends, box, loss, OPTIMIZER, SCHEDULE)
    trainer("training", max_steps=sizes.steps, val_check_interval=max(1, sizes.steps // 5)).fit(task, data)
    return morph.eval()


def measure(morph: NeuralMorph, sizes: argparse.Namespace) -> None:
    """Everything that `python -m nsm.evaluate` measures."""
    evaluation = evaluate_morph(morph, Protocol(sizes.resolution, sizes.resolution), print)
    for name, value in evaluation.figures().items():
        print(f"{name:28} {value:.3g}")
    curve, name = evaluation.volume, Path(sizes.film).stem
    write_volume_curve(beside(sizes, ".csv"), curve.times, curve.volumes)
    plot_volume_curves(beside(sizes, ".png"), {name: (curve.times, curve.volumes)})
    with whole_file(beside(sizes, ".json")) as temporary:
        temporary.write_text(json.dumps(evaluation.to_dict(), indent=2))


def film(morph: NeuralMorph, sizes: argparse.Namespace) -> None:
    """From the source to the target and back, turning a quarter, above the volume as it goes."""
    pace = Pace(seconds=sizes.seconds, back=True, turns=0.25)
    look = Look(resolution=sizes.resolution)
    render_film(sizes.film, morph, pace=pace, size=sizes.size, look=look, progress=tell)
    print(f"\nwrote {', '.join(str(beside(sizes, ending)) for ending in ('', '.csv', '.png', '.json'))}")


def trainer(title: str, **arguments: Any) -> L.Trainer:
    """A trainer that shows how far it is, and keeps nothing on disk."""
    # endless batches, and a count of steps to make
    quiet: dict[str, Any] = {"logger": False, "enable_checkpointing": False, "enable_model_summary": False}
    endless: dict[str, Any] = {"max_epochs": -1, "num_sanity_val_steps": 0, "check_val_every_n_epoch": None}
    return L.Trainer(callbacks=[Progress(title)], **(quiet | endless | arguments))


#: Called with the parameters, and with the optimiser and the number of steps.
OPTIMIZER: Callable[..., Any] = partial(SOAP, lr=1e-3, betas=(0.95, 0.95), weight_decay=0.0, precondition_frequency=10)
SCHEDULE = partial(warmup_cosine, warmup=0.1, floor=0.0)


def tell(done: int, total: int) -> None:
    """Count the frames."""
    print(f"\rframe {done} of {total}", end="", flush=True)


def beside(sizes: argparse.Namespace, ending: str) -> Path:
    """The file with the name of the film and another ending; the film itself for none."""
    return Path(sizes.film).with_suffix(ending) if ending else Path(sizes.film)


def read_arguments() -> argparse.Namespace:
    """What to morph, and how large everything is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", help="mesh at t = 0")
    parser.add_argument("target", help="mesh at t = 1")
    parser.add_argument("film", help="ends in .mp4 or .gif")
    parser.add_argument("--steps", type=int, default=2000, help="of training")
    parser.add_argument("--points", type=int, default=5000, help="in a batch")
    parser.add_argument("--width", type=int, default=128, help="of the network of f")
    parser.add_argument("--layers", type=int, default=6, help="of the network of f")
    parser.add_argument("--resolution", type=int, default=128, help="cells along the box for figures and film")
    parser.add_argument("--seconds", type=float, default=4.0, help="of the film, one way")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720), help="of the film in pixels")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(str(error)) from error
