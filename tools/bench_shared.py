"""Time of one training step alone, and beside one busy process per core, by how long idle threads keep their core.

    python tools/bench_shared.py [--threads N] [--rounds 8] [--seconds 2] [--spins 0 1000 10000]

A step is that of the default configuration (loss, velocity, optimizer, batch of 5 000 points), as in bench_step.py. It
runs in processes of its own, one per setting of GNU OpenMP: as shipped (what `nsm.cli.runtime.share_cores` sets), the
library's default, and those of --spins (times that a waiting thread looks for work before it sleeps). They are measured
in turn, each for so many seconds, so that all see the machine in one state; all the others sleep. The neighbors are
processes that count, one pinned to each core, and stopped while a step is measured alone. Figures are medians over the
rounds. Ideal is a ratio of 2: each core is shared by two. Linux only; with more cores at hand than N, pin it to N.
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

#: What is asked for: times slower beside neighbors, and part of the library's own speed lost when alone.
SLOWER, LOSS = 2.5, 0.05
#: What GNU OpenMP does by itself.
LIBRARY = 300_000
#: Points of a batch, and steps before the clock starts.
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
    # of each round, so that a machine that changes its speed does not count
    lost = statistics.median(a / b for a, b in zip(alone["as shipped"], alone["library's default"], strict=True)) - 1
    print(f"as shipped: {ratio:.2f} times slower beside neighbors (asked for: {SLOWER} at most)")
    print(f"as shipped: {lost:+.1%} time when alone, against the library's default (asked for: {LOSS:.0%} at most)")
    sys.exit(ratio > SLOWER or lost > LOSS)


def read_arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=2.0, help="of one measurement")
    parser.add_argument("--spins", type=int, nargs="*", default=[], help="more settings to compare")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


class Worker:
    """A process that makes training steps when it is asked to, and otherwise sleeps."""

    def __init__(self, looks: int | None, threads: int) -> None:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_"))}
        if looks is not None:
            environment["GOMP_SPINCOUNT"] = str(looks)
        command = [sys.executable, __file__, "--worker", "--threads", str(threads)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)
        self.step(0.0)

    def step(self, seconds: float) -> float:
        """Mean time of one step in s, measured for about so many seconds."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(seconds, file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())


def work(threads: int) -> None:
    """Make steps for as long as each line of the input says, and print the seconds of one."""
    import torch  # after nsm: what that has set is what is measured
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
    """One process per core that counts, stopped until it is told to go on."""
    count = "import os\nos.sched_setaffinity(0, [{}])\nwhile True: pass"
    cores = sorted(os.sched_getaffinity(0))
    neighbors = [subprocess.Popen([sys.executable, "-c", count.format(core)]) for core in cores]
    tell(neighbors, signal.SIGSTOP)
    try:
        yield neighbors
    finally:
        for neighbor in neighbors:
            neighbor.kill()


def tell(processes: list[subprocess.Popen[bytes]], what: signal.Signals) -> None:
    """Send a signal to each."""
    for process in processes:
        process.send_signal(what)


if __name__ == "__main__":
    main()
