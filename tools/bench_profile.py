"""Profile a whole training step inside the training command.

    python tools/bench_profile.py [--steps 60] [--threads 2] [overrides of python -m nsm.train …]

This trains the default pair with the default configuration: its batch size, Lightning's loop, the logger, the progress
bar, and the callbacks. The time of a part is the time spent in its functions, without that in functions of another part
that they call. A step lasts from the end of one to the end of the next, so it includes drawing the batch and
excludes validation; the steps before the optimizer has computed its bases do not count. At least 85 % of a step must be
spent in the sweeps of the networks and the matrix products of the optimizer.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from typing import Any

import nsm  # noqa: F401 (before torch, which reads what nsm sets)

# isort: split
import lightning as L
import pytorch_optimizer
import torch
from lightning.pytorch.loops.optimization.automatic import Closure
from lightning.pytorch.trainer.connectors.logger_connector.logger_connector import _LoggerConnector

from nsm import calculus
from nsm.cli import entry
from nsm.sampling import EndSurfaces, MorphSampler, MovingSurface
from nsm.train import __main__ as train
from nsm.train.callbacks import Progress
from nsm.train.tasks import FieldTask

#: Parts that should make up a step, and the least share that they must have.
USEFUL, LEAST = ("sweeps of the networks", "products of the optimizer"), 0.85
#: Steps before the measurement starts.
WARM_UP = 12
SWEEPS = (calculus._ScalarSweep, calculus._TangentSweep)
LOSSES, REST = "losses, forward and backward", "everything else"
#: Functions by the part to which their time belongs.
PARTS: dict[str, list[tuple[Any, str]]] = {
    USEFUL[0]: [(sweep, name) for sweep in SWEEPS for name in ("forward", "backward")],
    USEFUL[1]: [(torch, "tensordot"), (pytorch_optimizer.SOAP, "get_orthogonal_matrix_qr")],
    "rest of the optimizer": [(pytorch_optimizer.SOAP, "step")],
    LOSSES: [(FieldTask, "training_step"), (torch.Tensor, "backward")],
    "sampling": [
        (MorphSampler, "draw"),
        *[(points, name) for points in (MovingSurface, EndSurfaces) for name in ("place", "follow")],
    ],
    "logging and progress": [
        (FieldTask, "on_train_batch_end"),
        (L.LightningModule, "log"),
        (L.LightningModule, "log_dict"),
        (Progress, "on_train_batch_end"),
        *[(_LoggerConnector, name) for name in ("on_batch_start", "on_batch_end", "update_train_step_metrics")],
    ],
    REST: [(Closure, "__call__")],
}


def main() -> None:
    """Train, and print the table."""
    arguments, overrides = read_arguments()
    clock = Clock(arguments.steps)
    for part, functions in PARTS.items():
        for owner, name in functions:
            clock.watch(part, owner, name)
    clock.count(FieldTask, "on_train_batch_end")
    with tempfile.TemporaryDirectory() as folder:
        # no validation before the last step has been counted, and nothing drawn after it
        fixed = [f"steps={clock.last}", "validations=1", "callbacks=none", "init=siren", f"hydra.run.dir={folder}"]
        sys.argv[1:] = [*fixed, f"threads={arguments.threads}", *overrides]
        entry.run(train.main, "train")
    total = sum(clock.seconds.values())
    print(f"\n{arguments.steps} steps on {arguments.threads} threads, {total / arguments.steps * 1e3:.1f} ms each\n")
    print("| part of a step | ms | share |\n|---|---|---|")
    for part in PARTS:
        print(f"| {part} | {clock.seconds[part] / arguments.steps * 1e3:.2f} | {clock.seconds[part] / total:.1%} |")
    useful = sum(clock.seconds[part] for part in USEFUL) / total
    print(f"\nsweeps and the optimizer's products are {useful:.1%} of a step (required: at least {LEAST:.0%})")
    sys.exit(useful < LEAST)


def read_arguments() -> tuple[argparse.Namespace, list[str]]:
    """Read the command line; returns the arguments of this tool and those of the training command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=60, help="steps to measure")
    parser.add_argument("--threads", type=int, default=2, help="threads of torch")
    return parser.parse_known_args()


class Clock:
    """Assigns time to the innermost part whose function is running.

    Args:
        steps: Number of steps to measure, after the first `WARM_UP`.
    """

    def __init__(self, steps: int) -> None:
        self.last = WARM_UP + steps
        self.seconds: dict[str, float] = defaultdict(float)
        self._running, self._since, self._steps = [REST], 0.0, 0

    def watch(self, part: str, owner: Any, name: str) -> None:
        """Wrap a function of a class or module so that its time belongs to a part."""

        def timed(function: Callable[..., Any]) -> Callable[..., Any]:
            @wraps(function)
            def call(*args: Any, **kwargs: Any) -> Any:
                self._charge()
                self._running.append(part)
                try:
                    return function(*args, **kwargs)
                finally:
                    self._charge()
                    self._running.pop()

            return call

        self._replace(owner, name, timed)

    def count(self, owner: Any, name: str) -> None:
        """Wrap the function whose return ends a step."""

        def counted(function: Callable[..., Any]) -> Callable[..., Any]:
            @wraps(function)
            def call(*args: Any, **kwargs: Any) -> Any:
                result = function(*args, **kwargs)
                self._charge()
                self._steps += 1
                return result

            return call

        self._replace(owner, name, counted)

    def _charge(self) -> None:
        now = time.perf_counter()
        if WARM_UP <= self._steps < self.last:
            self.seconds[self._running[-1]] += now - self._since
        self._since = now

    @staticmethod
    def _replace(owner: Any, name: str, change: Callable[[Callable[..., Any]], Callable[..., Any]]) -> None:
        found = vars(owner)[name]
        static = isinstance(found, staticmethod)
        replacement = change(found.__func__ if static else found)
        setattr(owner, name, staticmethod(replacement) if static else replacement)


if __name__ == "__main__":
    main()
