"""Measure a training step alone and beside one busy process per core, for several spin counts of waiting threads.

    python tools/bench_shared.py [--threads N] [--rounds 8] [--seconds 2] [--spins 0 1000 10000]

The step is that of the default configuration (loss, velocity, optimizer, batch of 5 000), as in bench_step.py. It
runs in one process per setting of GNU OpenMP: as shipped (set by `nsm.cli.runtime.share_cores`), the default of the
library, and those of --spins, each a number of times that a waiting thread looks for work before it sleeps. The
processes take turns, so that all see the machine in the same state. The busy neighbors, one pinned to each core, are
stopped while a step is measured alone. Results are medians over the rounds; the ideal ratio is 2, since two
processes share each core. Linux only; on a machine with more than N cores, pin the tool to N of them.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from nsm.cli.runtime import keep_freed_memory

#: Largest acceptable slowdown beside neighbors, and largest share of the library's own speed lost when alone.
SLOWER, LOSS = 2.5, 0.05
#: Default spin count of GNU OpenMP.
LIBRARY = 300_000
#: Points of a batch, and steps before the measurement starts.
POINTS, WARM_UP = 5_000, 12


def main() -> None:
    """Measure and print."""
    arguments = read_arguments()
    if arguments.worker:
        work(arguments.threads)
        return
    settings = {"as shipped": None, "library's default": LIBRARY} | {f"{n} looks": n for n in arguments.spins}
    alone: dict[str, list[float]] = {name: [] for name in settings}
    shared: dict[str, list[float]] = {name: [] for name in settings}
    workers = {name: Worker(looks, arguments.threads) for name, looks in settings.items()}
    try:
        with busy_cores() as neighbors:
            for _ in range(arguments.rounds):
                for name, worker in workers.items():
                    alone[name].append(worker.step(arguments.seconds))
                tell(neighbors, signal.SIGCONT)
                for name, worker in workers.items():
                    shared[name].append(worker.step(arguments.seconds))
                tell(neighbors, signal.SIGSTOP)
    finally:
        for worker in workers.values():
            worker.process.kill()
    print(f"step of {POINTS} points on {arguments.threads} threads, {len(os.sched_getaffinity(0))} cores")
    print(f"{'waiting threads':<18} {'alone':>10} {'shared':>10} {'ratio':>7}")
    for name in settings:
        a, s = statistics.median(alone[name]), statistics.median(shared[name])
        print(f"{name:<18} {a * 1e3:7.1f} ms {s * 1e3:7.1f} ms {s / a:7.2f}")
    ratio = statistics.median(shared["as shipped"]) / statistics.median(alone["as shipped"])
    # within each round, so that a change in the machine's speed cancels
    lost = statistics.median(a / b for a, b in zip(alone["as shipped"], alone["library's default"], strict=True)) - 1
    print(f"as shipped: {ratio:.2f} times slower beside neighbors (required: at most {SLOWER})")
    print(f"as shipped: {lost:+.1%} time when alone, against the library's default (required: at most {LOSS:.0%})")
    sys.exit(ratio > SLOWER or lost > LOSS)


def read_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=2.0, help="duration of one measurement")
    parser.add_argument("--spins", type=int, nargs="*", default=[], help="further spin counts to compare")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


class Worker:
    """A process that makes training steps on request and otherwise sleeps."""

    def __init__(self, looks: int | None, threads: int) -> None:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_"))}
        if looks is not None:
            environment["GOMP_SPINCOUNT"] = str(looks)
        command = [sys.executable, __file__, "--worker", "--threads", str(threads)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)
        self.step(0.0)

    def step(self, seconds: float) -> float:
        """Mean seconds per step, measured over about the given time."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(seconds, file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())


def work(threads: int) -> None:
    """Make steps for the seconds that each line of the input gives, and print the mean seconds per step."""
    import torch  # after nsm, whose settings are measured here
    from bench_step import make_step

    torch.set_num_threads(threads)
    keep_freed_memory()
    step = make_step("adadiv", POINTS, POINTS)
    for _ in range(WARM_UP):
        step()
    for line in sys.stdin:
        begin, steps = time.perf_counter(), 0
        while not steps or time.perf_counter() - begin < float(line):
            step()
            steps += 1
        print((time.perf_counter() - begin) / steps, flush=True)


@contextmanager
def busy_cores() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Start one busy process per core, stopped until it gets SIGCONT."""
    count = "import os\nos.sched_setaffinity(0, [{}])\nwhile True: pass"
    cores = sorted(os.sched_getaffinity(0))
    neighbors = [subprocess.Popen([sys.executable, "-c", count.format(core)]) for core in cores]
    tell(neighbors, signal.SIGSTOP)
    try:
        yield neighbors
    finally:
        for neighbor in neighbors:
            neighbor.kill()


def tell(processes: list[subprocess.Popen[bytes]], number: signal.Signals) -> None:
    """Send a signal to each process."""
    for process in processes:
        process.send_signal(number)


if __name__ == "__main__":
    main()
