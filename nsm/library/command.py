"""The command ``nsm morph a.obj b.obj -o film.mp4``: shape files in, a film, an animation, or meshes out."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from omegaconf import OmegaConf
from rich.console import Console

from nsm.cli.errors import InputError
from nsm.cli.groups import option_names
from nsm.cli.settings import choice, nearest, whole_number
from nsm.io.timing import read_timing
from nsm.library.trained import FRAMES, OUTPUTS, RESOLUTION
from nsm.library.training import morph

#: Values of ``--symmetry``.
PLANES = ("none", "x", "y", "z")
_EXAMPLE = "nsm morph a.obj b.obj -o film.mp4"


class _Parser(argparse.ArgumentParser):
    """A parser whose errors look like all others."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        raise InputError(f"The command line must be valid, got an error: {message}. Try `{_EXAMPLE}`.")


def main(arguments: list[str]) -> None:
    """Morph shapes into each other and write the result.

    Args:
        arguments: Command line after ``nsm morph``.

    Raises:
        InputError: If the command line or a shape cannot be used.
    """
    given = _parser().parse_args(arguments)
    choice("budget", given.budget, option_names("budget"))
    choice("align", given.align, option_names("align"))
    choice("symmetry", given.symmetry, PLANES)
    whole_number("frames", given.frames, least=2, example=FRAMES)
    whole_number("resolution", given.resolution, least=8, example=RESOLUTION)
    read_timing(given.timing)  # fails before training
    output = _output(given)
    source, *between, target = _shapes(given.shapes)
    result = morph(
        source,
        target,
        between=between,
        times=None if given.times is None else _times(given.times),
        budget=given.budget,
        seed=given.seed,
        output=given.keep,
        source_settings=_settings("source", given.source_setting),
        target_settings=_settings("target", given.target_setting),
        between_settings=_settings("between", given.between_setting),
        align=given.align,
        landmarks=given.landmarks,
        symmetry=given.symmetry,
    )
    written = result.save(output, frames=given.frames, resolution=given.resolution, timing=given.timing)
    Console(soft_wrap=True, highlight=False, markup=False).print(f"wrote {written}")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="nsm morph",
        description="Morph one shape into another of the same volume, by way of others if given, and write the result.",
        epilog=f"example: {_EXAMPLE}",
    )
    parser.add_argument(
        "shapes",
        nargs="+",
        metavar="shape",
        help="two or more shapes, from the first to the last: each the file of a mesh, points, a volume of labels, an "
        "image or drawing, a network, or a fitted shape; or a name such as bunny",
    )
    parser.add_argument(
        "--times",
        metavar="T,T,…",
        help="times of all shapes, from 0 to 1, such as 0,0.4,1 (default: evenly spaced)",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="PATH",
        help=f"file that ends in {', '.join(OUTPUTS)}, or a folder for meshes; by default one named after the first "
        "and the last shape",
    )
    parser.add_argument("--budget", default="full", help="training budget, fast or full (default: %(default)s)")
    parser.add_argument(
        "--align",
        default="none",
        help="how the target is moved to the source: none, shared (coordinates of both files), rigid, or similarity "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--landmarks",
        metavar="FILE.csv",
        help="corresponding points that the motion carries, with a point of the source and one of the target per row, "
        "in the coordinates of both files",
    )
    parser.add_argument(
        "--symmetry",
        default="none",
        help="mirror plane that the motion keeps, through the center of both shapes: x, y, or z for the axis "
        "perpendicular to it, or none (default: %(default)s)",
    )
    parser.add_argument(
        "--timing",
        default="linear",
        help="pace of the motion: linear, smooth, ease_in, or ease_out (default: %(default)s)",
    )
    parser.add_argument(
        "--frames", type=int, default=FRAMES, metavar="N", help="number of meshes or pictures (default: %(default)s)"
    )
    parser.add_argument(
        "--resolution", type=int, default=RESOLUTION, metavar="N", help="cells along the box (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all random numbers")
    for side, which in (("source", "the first shape"), ("target", "the last shape"), ("between", "all shapes between")):
        parser.add_argument(
            f"--{side}-setting", action="append", default=[], metavar="NAME=VALUE",
            help=f"setting of {which}, such as label=3 or up=[0,0,1]; may be repeated",
        )  # fmt: skip
    parser.add_argument("--keep", metavar="FOLDER", help="folder that keeps the training run and its checkpoints")
    return parser


def _shapes(given: Sequence[str]) -> Sequence[str]:
    if len(given) < 2:
        raise InputError(f"`nsm morph` must be given two or more shapes, got {given[0]} alone. Try `{_EXAMPLE}`.")
    return given


def _times(text: str) -> list[float]:
    """Times from the command line, ``0,0.4,1``."""
    try:
        return [float(time) for time in text.split(",")]
    except ValueError:
        raise InputError(f"`--times` must be numbers with commas between, got {text}. Try `--times 0,0.4,1`.") from None


def _settings(side: str, typed: Sequence[str]) -> dict[str, Any]:
    """The settings of a shape, whose values are written as in YAML."""
    settings = {}
    for text in typed:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise InputError(
                f"`--{side}-setting` must have the form NAME=VALUE, got {text}. Try `--{side}-setting label=3`."
            )
        settings[name] = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={value}"]))["value"]  # type: ignore[call-overload, index]
    return settings


def _output(given: argparse.Namespace) -> Path:
    """The file or folder to write, checked before training begins."""
    if given.output is None:
        return Path(f"{Path(given.shapes[0]).stem}_{Path(given.shapes[-1]).stem}")
    output = Path(given.output)
    suffix = output.suffix.lower()
    if suffix and suffix not in OUTPUTS:
        suggestion = output.with_suffix(nearest(suffix, OUTPUTS) or ".mp4")
        raise InputError(
            f"`--output` must end in {', '.join(OUTPUTS)}, or have no suffix, got {output}. "
            f"Try `--output {suggestion}`."
        )
    return output
