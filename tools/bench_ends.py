"""Time of a frame with exact ends beside one of the bare network, and the error of the flow maps, measured in this run.

    python tools/bench_ends.py [checkpoint=PATH | official=kitten_fandisk] [--resolution 128] [--threads 2]

A frame is the surface at one time with its normals, as an export extracts it. Frames of both kinds take turns. The
tables of `nsm.ExactEnds` are made once for a morph and the flow map once for a time; a frame includes its flow map, and
the tables are timed by themselves and spread over the frames of an export of 24. Times are those of the processor, all
threads together. The error is that of the flow maps against direct integration of V, and that of f̃ which follows.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import torch

from nsm import ExactEnds, load_morph
from nsm.io.official import load_official
from nsm.morphs.surfaces import extract_frame
from nsm.types import Morph

#: What is asked for: times as long.
SLOWER = 2.0
#: Times of the frames, and how many an export has by default.
TIMES, EXPORT = (0.1, 0.3, 0.5, 0.7, 0.9), 24
#: A time so close to an end that the shape itself is read.
NEAR = 0.02


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("morph", nargs="?", default="official=kitten_fandisk", help="checkpoint=PATH or official=NAME")
    parser.add_argument("--resolution", type=int, default=128, help="cells of the frames along the box")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    kind, _, value = arguments.morph.rpartition("=")
    bare = load_official(value) if kind == "official" else load_morph(value)
    exact = ExactEnds(bare)
    extract_frame(bare, 0.5, 32)  # the first call pays for tables and threads
    first, after = (timed(lambda: extract_frame(exact, 0.5, arguments.resolution)) for _ in range(2))
    tables = first - after
    print(f"{arguments.morph}, {arguments.resolution} cells, {arguments.threads} threads")
    print(f"tables and one flow map, once  {tables:6.2f} s")
    rows = {t: both(bare, exact, t, arguments.resolution) for t in (*TIMES, 0.0, NEAR)}
    for t, (without, with_ends) in sorted(rows.items()):
        print(f"t = {t:4g}: bare {without:6.2f} s, exact {with_ends:6.2f} s, {with_ends / without:5.2f} x")
    without, with_ends = (sum(rows[t][kind] for t in TIMES) / len(TIMES) for kind in (0, 1))
    print(f"mean at {TIMES}: {with_ends / without:.2f} x   (asked for: {SLOWER:g} x)")
    print(f"the same with the tables spread over {EXPORT} frames: {(with_ends + tables / EXPORT) / without:.2f} x")
    error = exact.flow_error()
    print(f"flow maps: mean error {error.mean:.2g}, greatest {error.maximum:.2g}; error of f {error.field:.2g}")
    sys.exit(not with_ends <= SLOWER * without)


def both(bare: Morph, exact: Morph, t: float, resolution: int) -> tuple[float, float]:
    """Seconds of a frame of the bare network, and of one with exact ends."""
    without = timed(lambda: extract_frame(bare, t, resolution))
    return without, timed(lambda: extract_frame(exact, t, resolution))


def timed(work: Callable[[], object]) -> float:
    """Seconds that a piece of work takes, of the processor: neighbors on the machine do not count."""
    start = time.process_time()
    work()
    return time.process_time() - start


if __name__ == "__main__":
    main()
