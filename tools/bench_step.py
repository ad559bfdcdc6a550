"""Compare a training step with the machine's rate of matrix products, and the step of each method with AdaDiv's.

    python tools/bench_step.py [--threads 2] [--rounds 8] [--methods adadiv lf_insd …]

The measurements take turns. A step (forward, backward, and update) is that of the method's own configuration (loss,
velocity, optimizer), with networks of 6 layers of 128, on 20 000 points in 3D: 5 000 on the surfaces, 5 000 around
them, and 10 000 inside space-time. For AdaDiv, the least number of floating-point operations is counted from the
matrix products of the chain rule: per layer, f with its gradient takes two products forward (values, reverse sweep) and
two for each of them backward, and V with its tangents takes (1 + d) forward and twice that backward. First layers have
d + 1 inputs and are counted the same way. The reference is the rate of torch.mm of (20 000 × 128) by (128 × 128),
the product of which a step consists.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import nsm  # noqa: F401 (before torch, which reads what nsm sets)

# isort: split
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from nsm.cli.configuration import CONF
from nsm.cli.runtime import keep_freed_memory
from nsm.losses import BatchEvaluation
from nsm.sampling import Batch
from nsm.shapes import LandmarkPairs, SirenShape
from nsm.types import Key

SURFACE, AMBIENT, INTERIOR = 5_000, 5_000, 10_000
DIM, WIDTH, DEPTH = 3, 128, 6
LANDMARKS = 500
#: Methods that are trained by an optimizer.
METHODS = ("adadiv", "nulldiv", "free", "penalty", "nise", "nise_official", "lf_insd", "insd", "lipmlp")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--block", type=int, default=5_000, help="points per block, whose gradients are accumulated")
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(0)
    keep_freed_memory()

    methods = dict.fromkeys(("adadiv", *arguments.methods))
    calls = {name: make_step(name, arguments.block) for name in methods}
    product = make_product()
    calls["product"] = lambda: [product() for _ in range(20)]
    seconds = measured(calls, arguments.rounds)

    step = seconds["adadiv"]
    rate = 2 * (SURFACE + AMBIENT + INTERIOR) * WIDTH**2 / (seconds["product"] / 20)
    count = least_operations()
    parts = f"(f {operations_of_f() / 1e9:.2f}, V {operations_of_v() / 1e9:.2f})"
    print(f"least operations  {count / 1e9:8.2f} GFLOP  {parts}")
    print(f"step of adadiv    {step:8.3f} s      {count / step / 1e9:6.1f} GFLOP/s")
    print(f"matrix product    {seconds['product'] / 20 * 1e3:8.3f} ms     {rate / 1e9:6.1f} GFLOP/s")
    print(f"step / product    {count / step / rate:8.1%} of the rate, on {arguments.threads} threads")
    for name in methods:
        print(f"step of {name:<9} {seconds[name]:8.3f} s      {seconds[name] / step:6.2f} × adadiv")


def measured(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median seconds of each call after two warm-ups; calls take turns, so that all see the machine alike."""
    for call in calls.values():
        call()
        call()
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - begin)
    return {name: statistics.median(times) for name, times in seconds.items()}


def least_operations() -> int:
    """Multiplications and additions of one step."""
    return operations_of_f() + operations_of_v()


def operations_of_f() -> int:
    """Operations of value and gradient at all points, forward and backward: 2 + 4 products per layer."""
    return 2 * 6 * (SURFACE + AMBIENT + INTERIOR) * (weights(1) + WIDTH * (DIM + 1))


def operations_of_v() -> int:
    """Operations of value and tangents at interior points, forward and backward: (1 + d) (1 + 2) products per layer."""
    first = WIDTH * (DIM + 1)  # the tangents of the first layer are its weights: no product
    return 2 * 3 * INTERIOR * ((1 + DIM) * weights(1 + DIM) + first)


def weights(outputs: int) -> int:
    """Number of entries of all weight matrices except the first."""
    return (DEPTH - 1) * WIDTH**2 + WIDTH * outputs


def make_step(method: str, block: int, points: int = SURFACE + AMBIENT + INTERIOR) -> Callable[[], None]:
    """Build one optimizer step of a method on random points, in blocks whose intermediate results stay in the cache."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", [f"method={method}"])
    made: Any = {part: instantiate(cfg[part], _convert_="all") for part in ("loss", "optimizer", "sampler")}
    keys = [Key(time, SirenShape(DIM, WIDTH, DEPTH, omega=30.0)) for time in (0.0, 1.0)]
    field, velocity = instantiate(cfg.field, in_features=DIM + 1), None
    if cfg.velocity:
        velocity = instantiate(cfg.velocity, dim=DIM)
        velocity.attach(field, keys)
    parameters = [*field.parameters(), *(velocity.parameters() if velocity else ())]
    optimizer = made["optimizer"](parameters)
    blocks = [random_batch(*made["sampler"]["fractions"].counts(block)) for _ in range(points // block)]
    landmarks = LandmarkPairs(torch.rand(LANDMARKS, DIM), torch.rand(LANDMARKS, DIM))

    def step() -> None:
        optimizer.zero_grad()
        for batch in blocks:
            total, _ = made["loss"](BatchEvaluation(batch, field, velocity, landmarks, keys=keys))
            (total / len(blocks)).backward()
        optimizer.step()

    return step


def random_batch(surface: int, ambient: int, interior: int) -> Batch:
    """Draw a batch of random points."""
    normals = torch.nn.functional.normalize(torch.randn(surface, DIM), dim=1)
    points = torch.rand(surface + ambient + interior, DIM + 1) * 2 - 1
    return Batch(points, torch.rand(surface + ambient), normals)


def make_product() -> Callable[[], None]:
    """Build the matrix product of which layers consist, with its result written in place."""
    n = SURFACE + AMBIENT + INTERIOR
    a, b, c = torch.randn(n, WIDTH), torch.randn(WIDTH, WIDTH), torch.empty(n, WIDTH)
    return lambda: torch.mm(a, b, out=c)


if __name__ == "__main__":
    main()
