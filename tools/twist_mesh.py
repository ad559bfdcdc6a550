"""A mesh twisted by a known map, for landmarks that are known: vertex i of the one belongs to vertex i of the other.

    python tools/twist_mesh.py bunny.obj twisted.obj --degrees 90
    python -m nsm.train method=insd landmarks=vertices shape@source=mesh source.path=bunny.obj \\
        shape@target=mesh target.path=twisted.obj

Each slice across the axis turns about the middle of the mesh, by an angle that grows evenly along the axis: from minus
to plus half of `--degrees`. The map keeps volumes, so a motion without divergence can follow it.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh

from nsm.cli.files import whole_file


def main() -> None:
    """Read, twist, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh")
    parser.add_argument("twisted")
    parser.add_argument("--degrees", type=float, default=90.0, help="between the two ends")
    parser.add_argument("--axis", choices="xyz", default="y")
    arguments = parser.parse_args()
    mesh = trimesh.load_mesh(arguments.mesh, process=False, maintain_order=True)
    points = twisted(mesh.vertices, "xyz".index(arguments.axis), np.radians(arguments.degrees))
    with whole_file(arguments.twisted) as temporary:
        trimesh.Trimesh(points, mesh.faces, process=False).export(temporary)
    print(f"wrote {arguments.twisted}: {len(points):,} vertices, twisted by {arguments.degrees:g} degrees")


def twisted(points: np.ndarray, axis: int, angle: float) -> np.ndarray:
    """Points (n, 3) turned about an axis through the middle of their box, by -angle/2 at its low end to +angle/2."""
    low, high = points.min(0), points.max(0)
    local = points - (low + high) / 2
    turn = angle * local[:, axis] / (high - low)[axis]
    first, second = (axis + 1) % 3, (axis + 2) % 3
    a, b = local[:, first], local[:, second]
    moved = local.copy()
    moved[:, first], moved[:, second] = np.cos(turn) * a - np.sin(turn) * b, np.sin(turn) * a + np.cos(turn) * b
    return moved + (low + high) / 2


if __name__ == "__main__":
    main()
