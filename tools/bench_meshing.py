"""Compare coarse-to-fine extraction of a surface with marching cubes on a dense grid.

    python tools/bench_meshing.py [checkpoint=PATH | official=kitten_fandisk] [--resolution 256] [--memory 512]

The surface is that of a morph at one time, by default of the authors' kitten to fandisk. The dense method evaluates f
at all (r + 1)^3 corners of cells and runs marching cubes on them. Both methods must give the same mesh: vertices agree
within 1e-6 of the box's half width, and the triangles on them form the same set. Peak memory is measured in a
process that only loads the morph and extracts the surface.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from functools import partial

import numpy as np
import torch
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.meshing import OFF_LEVEL, extract_surface
from nsm.io.checkpoint import load_morph
from nsm.io.official import load_official
from nsm.types import Morph

#: Required speed-up, largest distance between corresponding vertices, and largest peak memory in bytes.
FASTER, SAME, MEMORY = 10, 1e-6, 2 << 30


def main() -> None:
    """Measure, compare and print."""
    arguments = read_arguments()
    torch.set_num_threads(arguments.threads)
    morph = load(arguments.morph)
    if arguments.measure_memory:
        extract_surface(partial(morph, t=arguments.time), morph.bounds, arguments.memory)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
        return
    points = 0

    def field(x: torch.Tensor) -> torch.Tensor:
        nonlocal points
        points += len(x)
        return morph(x, arguments.time)

    extract_surface(field, morph.bounds, 32)  # the first call builds tables and starts threads
    points, start = 0, time.perf_counter()
    mesh = extract_surface(field, morph.bounds, arguments.resolution)
    fast, sampled = time.perf_counter() - start, points
    points, start = 0, time.perf_counter()
    vertices, faces = dense(field, morph, arguments.resolution)
    slow = time.perf_counter() - start
    print(f"{arguments.morph} at t = {arguments.time:g}, {arguments.resolution} cells, {arguments.threads} threads")
    print(f"coarse to fine  {fast:7.2f} s  {sampled:>11,} points  {len(mesh.simplices):,} triangles")
    print(f"dense           {slow:7.2f} s  {points:>11,} points  {len(faces):,} triangles")
    print(f"                {slow / fast:7.1f} x {points / sampled:>11.1f} x   (required: {FASTER} x the time)")
    distance, same = compare(mesh.vertices.double().numpy(), mesh.simplices.numpy(), vertices, faces)
    print(f"vertices within {distance:.1e} of each other, triangles {'the same' if same else 'NOT THE SAME'}")
    child = [sys.executable, *sys.argv, "--measure-memory"]
    peak = int(subprocess.run(child, check=True, capture_output=True, text=True).stdout.split()[-1])
    required = f"(required: less than {MEMORY / (1 << 30):g} GiB)"
    print(f"peak memory at {arguments.memory} cells {peak / (1 << 30):.2f} GiB {required}")
    sys.exit(not (slow / fast >= FASTER and distance <= SAME and same and peak < MEMORY))


def read_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("morph", nargs="?", default="official=kitten_fandisk", help="checkpoint=PATH or official=NAME")
    parser.add_argument("--resolution", type=int, default=256, help="cells along the box, for both methods")
    parser.add_argument("--memory", type=int, default=512, help="cells at which peak memory is measured")
    parser.add_argument("--time", type=float, default=0.5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--measure-memory", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def load(name: str) -> Morph:
    """Load the morph that an argument names."""
    kind, _, value = name.rpartition("=")
    return load_official(value) if kind == "official" else load_morph(value)


def dense(field, morph: Morph, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Run marching cubes on the full grid; returns vertices and triangles."""
    lattice = Lattice.corners(morph.bounds, resolution)
    values = np.empty(lattice.shape, dtype=np.float32)
    plane = torch.cartesian_prod(*(torch.arange(n, dtype=morph.bounds.dtype) for n in lattice.shape[1:]))
    for i, layer in enumerate(values):  # one layer at a time: the coordinates of all points would not fit into memory
        index = torch.cat([torch.full_like(plane[:, :1], i), plane], 1)
        layer[:] = evaluate(field, lattice.points(index)).view(lattice.shape[1:]).numpy()
    values /= float(lattice.step.max())
    values[np.abs(values) < OFF_LEVEL] = -OFF_LEVEL
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent")
    return vertices * lattice.step.double().numpy() + lattice.origin.double().numpy(), faces


def compare(vertices: np.ndarray, faces: np.ndarray, other: np.ndarray, other_faces: np.ndarray) -> tuple[float, bool]:
    """Greatest distance between corresponding vertices, and whether the triangles on them form the same set."""
    distance, partner = cKDTree(other).query(vertices)
    paired = len(vertices) == len(other) == len(np.unique(partner))
    return float(distance.max()), paired and np.array_equal(canonical(partner[faces]), canonical(other_faces))


def canonical(faces: np.ndarray) -> np.ndarray:
    """Rotate triangles so that their smallest index comes first, and sort them."""
    turn = (faces.argmin(1)[:, None] + np.arange(3)) % 3
    turned = np.take_along_axis(faces, turn, 1)
    return turned[np.lexsort(turned.T[::-1])]


if __name__ == "__main__":
    main()
