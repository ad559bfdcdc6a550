"""Make docs/gallery.md: morphs of ten pairs as strips of pictures, with how well each preserves its volume.

python tools/gallery.py                                  # trains every pair into outputs/gallery, some minutes each
python tools/gallery.py --runs outputs/studies/pairs     # draws runs that were trained before: FOLDER/PAIR/…
python tools/gallery.py budget=fast --pairs spot_bob     # some pairs, with settings of the training command
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import nsm  # isort: skip (before torch, so that the settings of its threads apply)
import yaml

from nsm.cli.configuration import CONF
from nsm.plots.strip import render_strip

ROOT = Path(__file__).resolve().parents[1]
#: The pairs of the study of that name, and these two in 2D.
PAIRS = [*yaml.safe_load((CONF / "study" / "pairs.yaml").read_text())["pairs"], "square_rectangle", "disk_translation"]
TRAINED = Path("outputs/gallery")
#: Times of the columns, and pixels across one picture.
TIMES, SIZE = (0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0), 240


def main() -> None:
    """Find or train a run of every pair, draw it, and write the page."""
    arguments = read_arguments()
    sections = []
    for pair in arguments.pairs:
        run = find_run(arguments.runs, pair) or find_run(TRAINED, pair) or train(pair, arguments.overrides)
        print(f"{pair}: {run}")
        sections.append(draw(pair, run, arguments.page, arguments.resolution))
    arguments.page.write_text("\n".join([introduction(), *sections]))
    print(f"wrote {arguments.page}")


def find_run(folder: Path | None, pair: str) -> Path | None:
    """The first run with a best checkpoint below ``folder/pair``."""
    found = sorted((folder / pair).rglob("checkpoints/best.ckpt")) if folder else []
    return found[0].parent.parent if found else None


def train(pair: str, overrides: Sequence[str]) -> Path:
    """Train a pair with the training command; a run that was interrupted resumes."""
    run = TRAINED / pair
    settings = [f"+experiment={pair}", f"hydra.run.dir={run}", "callbacks=none", "resume=true", *overrides]
    subprocess.run([sys.executable, "-m", "nsm.train", *settings], check=True)
    return run


def draw(pair: str, run: Path, page: Path, resolution: int) -> str:
    """Draw the strip of a run; returns its section of the page."""
    morph = nsm.load_morph(run)
    picture = page.with_suffix("") / f"{pair}.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    render_strip(picture, morph, TIMES, size=SIZE)
    curve = nsm.volume_curve(morph, TIMES, resolution)
    source, target = pair.split("_", 1)
    title = f"{source.capitalize()} → {target.replace('_', ' ')}" if source != "disk" else "A disk moves"
    return "\n".join(
        [
            f"## {title}",
            "",
            description(pair),
            f"The volume deviates by at most {curve.maximum_deviation:.2%}.",
            "",
            f"![{title}]({page.stem}/{picture.name})",
            "",
            f"`nsm train +experiment={pair}`",
            "",
        ]
    )


def description(pair: str) -> str:
    """The comment at the head of an experiment's configuration."""
    lines = (CONF / "experiment" / f"{pair}.yaml").read_text().splitlines()
    comments = [line.removeprefix("# ") for line in lines if re.match(r"# (?!@)", line)]
    return " ".join(comments)


def introduction() -> str:
    """The head of the page."""
    return (
        "# Gallery\n\n"
        "Every morph is of the default configuration with exact ends, drawn at t = 0, 0.2, 0.4, 0.5, 0.6, 0.8, and 1.\n"
        "`python tools/gallery.py` makes this page.\n"
    )


def read_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", help="choices and settings of the training command")
    parser.add_argument("--runs", type=Path, help="folder whose subfolders, named after pairs, hold finished runs")
    parser.add_argument("--pairs", nargs="+", choices=PAIRS, default=PAIRS, metavar="PAIR", help="some of the pairs")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "gallery.md", help="page to write")
    parser.add_argument("--resolution", type=int, default=96, help="cells along the box on which volume is measured")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        main()
    except nsm.InputError as error:
        raise SystemExit(str(error)) from error
