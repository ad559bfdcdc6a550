"""Morph two meshes, measure the result, and film it.

    python examples/two_meshes_to_film.py a.obj b.ply film.mp4

Beside the film go the checkpoint of the morph (`.ckpt`) and its figures of merit (`.json`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import nsm


def main() -> None:
    """Train, measure, film."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", help="mesh at t = 0")
    parser.add_argument("target", help="mesh at t = 1")
    parser.add_argument("film", type=Path, help="output, which ends in .mp4 or .gif")
    parser.add_argument("--steps", type=int, help="optimizer steps; by default those of the full budget")
    parser.add_argument("--resolution", type=int, default=128, help="cells along the box for figures and film")
    parser.add_argument("--seconds", type=float, default=4.0, help="duration of the film")
    arguments = parser.parse_args()

    morph = nsm.morph(arguments.source, arguments.target, steps=arguments.steps)
    morph.save(arguments.film.with_suffix(".ckpt"))
    morph.save(arguments.film, resolution=arguments.resolution, seconds=arguments.seconds)
    evaluation = nsm.evaluate_morph(morph)
    arguments.film.with_suffix(".json").write_text(json.dumps(evaluation.to_dict(), indent=2))
    print(f"volume at t = 0, 0.5, 1: {', '.join(f'{morph.volume(t):.4f}' for t in (0.0, 0.5, 1.0))}")


if __name__ == "__main__":
    try:
        main()
    except nsm.InputError as error:
        raise SystemExit(str(error)) from error
