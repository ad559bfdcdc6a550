"""Compare the time of a frame with exact ends with that of the networks alone, and measure the error of the flow maps.

    python tools/bench_ends.py [checkpoint=PATH | official=kitten_fandisk] [--resolution 128] [--threads 2]

A frame is the surface at one time with its normals, as an export extracts it; frames of both kinds alternate. The
tables of `nsm.ExactEnds` are computed once per morph and the flow map once per time. A frame includes its flow map; the
tables are timed separately and spread over the 24 frames of an export. Times are processor times, summed over all
threads. Errors are those of the flow maps against direct integration of V, and of f̃ as a consequence.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import torch

from nsm import ExactEnds
from nsm.io.checkpoint import load_morph
from nsm.io.official import load_official
from nsm.morphs.surfaces import extract_frame
from nsm.types import Morph

#: Largest acceptable ratio of the two times.
SLOWER = 2.0
#: Times t of the frames, and the default number of frames of an export.
TIMES, EXPORT = (0.1, 0.3, 0.5, 0.7, 0.9), 24
#: A time so close to an end that the shape itself is evaluated.
NEAR = 0.02


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("morph", nargs="?", default="official=kitten_fandisk", help="checkpoint=PATH or official=NAME")
    parser.add_argument("--resolution", type=int, default=128, help="cells along the box")
    parser.add_argument("--threads", type=int, default=2, help="threads of torch")
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
    print(f"mean at {TIMES}: {with_ends / without:.2f} x   (required: at most {SLOWER:g} x)")
    print(f"the same with the tables spread over {EXPORT} frames: {(with_ends + tables / EXPORT) / without:.2f} x")
    error = exact.flow_error()
    print(f"flow maps: mean error {error.mean:.2g}, greatest {error.maximum:.2g}; error of f {error.field:.2g}")
    sys.exit(not with_ends <= SLOWER * without)


def both(bare: Morph, exact: Morph, t: float, resolution: int) -> tuple[float, float]:
    """Seconds that a frame takes with the networks alone, and with exact ends."""
    without = timed(lambda: extract_frame(bare, t, resolution))
    return without, timed(lambda: extract_frame(exact, t, resolution))


def timed(work: Callable[[], object]) -> float:
    """Seconds of processor time that a piece of work takes, so that other processes do not count."""
    start = time.process_time()
    work()
    return time.process_time() - start


if __name__ == "__main__":
    main()
