"""Twist a mesh by a known map, so that vertex i of the result corresponds to vertex i of the mesh.

    python tools/twist_mesh.py bunny.obj twisted.obj --degrees 90
    nsm train method=insd landmarks=vertices shape@source=mesh source.path=bunny.obj \\
        shape@target=mesh target.path=twisted.obj

Each slice across the axis turns about the center of the mesh, by an angle that grows linearly along the axis from minus
to plus half of `--degrees`. The map preserves volume, so a divergence-free motion can follow it.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh

from nsm.cli.files import atomic_write


def main() -> None:
    """Read, twist, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", help="file to read")
    parser.add_argument("twisted", help="file to write")
    parser.add_argument("--degrees", type=float, default=90.0, help="angle between both ends")
    parser.add_argument("--axis", choices="xyz", default="y")
    arguments = parser.parse_args()
    mesh = trimesh.load_mesh(arguments.mesh, process=False, maintain_order=True)
    points = twisted(mesh.vertices, "xyz".index(arguments.axis), np.radians(arguments.degrees))
    with atomic_write(arguments.twisted) as temporary:
        trimesh.Trimesh(points, mesh.faces, process=False).export(temporary)
    print(f"wrote {arguments.twisted}: {len(points):,} vertices, twisted by {arguments.degrees:g} degrees")


def twisted(points: np.ndarray, axis: int, angle: float) -> np.ndarray:
    """Points (n, 3) rotated about an axis through the center of their box, by -angle/2 at its low end to +angle/2."""
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
