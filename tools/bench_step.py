"""Time of one training step beside the rate of plain matrix products, both measured in this run.

    python tools/bench_step.py [--threads 2] [--rounds 8]

The step is that of AdaDiv with the default losses and networks of 6 layers of 128, on 20 000 points: 5 000 on the
surfaces, 5 000 around them, 10 000 inside space-time; forward, backward and the update by SOAP. The least number of
floating-point operations that it needs is counted from the matrix products of the chain rule: f with its gradient takes
two products a layer forward (values, reverse sweep) and two for each of these backward; V with its tangents takes
(1 + d) forward and twice that backward; both with a first layer of d + 1 inputs, whose sweeps are counted the same way.
The rate it is held against is that of torch.mm of (20 000 × 128) by (128 × 128), the product that the step is made of.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import torch
from pytorch_optimizer import SOAP

from nsm.fields import AdaDiv, Gaussian, ScalarSiren, VectorSiren
from nsm.losses import AmbientDirichlet, Eikonal, Evaluation, LevelSet, NormalAlignment, SurfaceDirichlet, WeightedSum
from nsm.runtime import keep_freed_memory
from nsm.sampling import Batch

SURFACE, AMBIENT, INTERIOR = 5_000, 5_000, 10_000
DIM, WIDTH, DEPTH = 3, 128, 6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--block", type=int, default=5_000, help="points whose gradients are accumulated at once")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(0)
    keep_freed_memory()

    steps, step = {}, make_step(arguments.block)
    product = make_product()
    for name, call in (("step", step), ("product", product)):
        call()
        call()
        steps[name] = []
    for _ in range(arguments.rounds):  # in turn, so that both see the machine in the same state
        steps["step"].append(timed(step))
        steps["product"].append(timed(lambda: [product() for _ in range(20)]) / 20)
    seconds, one = statistics.median(steps["step"]), statistics.median(steps["product"])
    rate = 2 * (SURFACE + AMBIENT + INTERIOR) * WIDTH**2 / one
    count = least_operations()
    parts = f"(f {operations_of_f() / 1e9:.2f}, V {operations_of_v() / 1e9:.2f})"
    print(f"least operations  {count / 1e9:8.2f} GFLOP  {parts}")
    print(f"step              {seconds:8.3f} s      {count / seconds / 1e9:6.1f} GFLOP/s")
    print(f"matrix product    {one * 1e3:8.3f} ms     {rate / 1e9:6.1f} GFLOP/s")
    print(f"step / product    {count / seconds / rate:8.1%} of the rate, on {arguments.threads} threads")


def least_operations() -> int:
    """Of one step, in multiplications and additions."""
    return operations_of_f() + operations_of_v()


def operations_of_f() -> int:
    """Value and gradient at all points, forward and backward: 2 + 4 products a layer."""
    return 2 * 6 * (SURFACE + AMBIENT + INTERIOR) * (weights(1) + WIDTH * (DIM + 1))


def operations_of_v() -> int:
    """Value and tangents at interior points, forward and backward: (1 + d) (1 + 2) products a layer."""
    first = WIDTH * (DIM + 1)  # the tangents of the first layer are its weights: no product
    return 2 * 3 * INTERIOR * ((1 + DIM) * weights(1 + DIM) + first)


def weights(outputs: int) -> int:
    """Entries of all weight matrices but the first."""
    return (DEPTH - 1) * WIDTH**2 + WIDTH * outputs


def make_step(block: int) -> Callable[[], None]:
    """One optimiser step on random points, in blocks whose intermediate results stay in cache."""
    field = ScalarSiren(DIM + 1, WIDTH, DEPTH, 30.0)
    velocity = AdaDiv(DIM, partial(VectorSiren, hidden_features=WIDTH, hidden_layers=DEPTH, omega=10.0), Gaussian(0.1))
    loss = WeightedSum(
        {
            "level_set": LevelSet(5e4),
            "dirichlet": AmbientDirichlet(2.5e3),
            "surface": SurfaceDirichlet(2.5e3),
            "neumann": NormalAlignment(25, 1),
            "eikonal": Eikonal(100),
        }
    )
    optimizer = SOAP([*field.parameters(), *velocity.parameters()], lr=1e-3, weight_decay=0.0)
    blocks = [random_batch(block) for _ in range((SURFACE + AMBIENT + INTERIOR) // block)]

    def step() -> None:
        optimizer.zero_grad()
        for batch in blocks:
            total, _ = loss(Evaluation(batch, field, velocity))
            (total / len(blocks)).backward()
        optimizer.step()

    return step


def random_batch(size: int) -> Batch:
    """Points of a batch in the proportions of the whole step."""
    surface, ambient = size // 4, size // 4
    normals = torch.nn.functional.normalize(torch.randn(surface, DIM), dim=1)
    return Batch(torch.rand(size, DIM + 1) * 2 - 1, torch.rand(surface + ambient), normals)


def make_product() -> Callable[[], None]:
    """The product that layers are made of, with its result in place."""
    n = SURFACE + AMBIENT + INTERIOR
    a, b, c = torch.randn(n, WIDTH), torch.randn(WIDTH, WIDTH), torch.empty(n, WIDTH)
    return lambda: torch.mm(a, b, out=c)


def timed(call: Callable[[], object]) -> float:
    """Seconds of one call."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
