"""``python -m nsm.evaluate``: all quality figures of trained morphs, ours and the authors', side by side."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from nsm.cli import entry
from nsm.cli.settings import moments, number, positive, use_threads, whole_number
from nsm.evaluate.tables import print_table
from nsm.evaluate.writers import write_evaluations
from nsm.io.loading import LoadedMorph, load_morphs, output_folder
from nsm.metrics import STAGES, Evaluation, Protocol, evaluate_morph
from nsm.plots.slices import Plane, plot_residual_slices, require_slices
from nsm.plots.strip import try_strip

log = logging.getLogger(__name__)

#: Pictures that are drawn of all morphs of one dimension.
_PICTURES = 2


def main(cfg: DictConfig) -> None:
    """Load, measure, show and write."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    protocol = _protocol(config)
    picture_size = whole_number("picture_size", config["picture_size"], 16)
    times = moments("slices.times", config["slices"]["times"])
    plane = Plane(str(config["slices"]["axis"]), number("slices.offset", config["slices"]["offset"]))
    use_threads(config)
    named = load_morphs(config, "nsm.evaluate")
    subjects = [column for subject in named for column in _columns(subject)]
    by_dim = {
        dim: {s.name: s.morph for s in subjects if s.morph.dim == dim}
        for dim in sorted({s.morph.dim for s in subjects})
    }
    for morphs in by_dim.values():
        require_slices(morphs, times, plane)
    folder = Path(config["output"]) if config["output"] else output_folder(named, "evaluation")
    with _progress() as bar:
        results = _measure(subjects, protocol, bar)
        files = write_evaluations(folder, {s.name: s.origin for s in subjects}, results, protocol)
        task = bar.add_task("drawing", total=_PICTURES * len(by_dim))
        for dim, morphs in by_dim.items():
            suffix = ".png" if len(by_dim) == 1 else f"_{dim}d.png"
            slices, strip = folder / f"slices{suffix}", folder / f"strip{suffix}"
            bar.update(task, description="drawing slices")
            plot_residual_slices(slices, morphs, times, plane)
            bar.update(task, description="drawing the morphs", advance=1)
            drawn = try_strip(strip, morphs, size=picture_size)
            bar.advance(task)
            files += [slices, strip] if drawn else [slices]
    _show(results, protocol)
    for file in files:
        log.info("wrote %s", file)


def _protocol(config: Mapping[str, Any]) -> Protocol:
    return Protocol(
        whole_number("volume_resolution", config["volume_resolution"], 8),
        whole_number("surface_resolution", config["surface_resolution"], 8),
        whole_number("times", config["times"], 2),
        positive("shell_width", config["shell_width"]),
    )


def _progress() -> Progress:
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=Console(stderr=True))


def _columns(subject: LoadedMorph) -> list[LoadedMorph]:
    """A morph, and after one with exact ends that of its networks alone."""
    if subject.network is None:
        return [subject]
    return [
        subject,
        subject._replace(name=f"{subject.name} (network)", morph=subject.network, exact=None, network=None),
    ]


def _measure(subjects: list[LoadedMorph], protocol: Protocol, bar: Progress) -> dict[str, Evaluation]:
    results = {}
    for subject in subjects:
        task = bar.add_task("", total=STAGES)
        # a stage is done when the next one begins
        started: list[str] = []

        def tell(stage: str, name: str = subject.name, task: Any = task, started: list[str] = started) -> None:
            bar.update(task, completed=len(started), description=f"{name}: {stage}".replace("[", r"\["))
            started.append(stage)

        flow_error = None if subject.exact is None else subject.exact.flow_error
        results[subject.name] = evaluate_morph(subject.morph, protocol, tell, flow_error)
        bar.update(task, completed=STAGES, description=f"{subject.name}: measured".replace("[", r"\["))
    return results


def _show(results: dict[str, Evaluation], protocol: Protocol) -> None:
    title = (
        f"volume on {protocol.volume_resolution}^d cells at {protocol.times} times, "
        f"ends on {protocol.surface_resolution}^d"
    )
    print_table({name: result.figures() for name, result in results.items()}, title)


if __name__ == "__main__":
    entry.run(main, "evaluate")
