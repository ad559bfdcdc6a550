"""``python -m nsm.evaluate``: all figures of merit of trained and published morphs, side by side."""

from __future__ import annotations

import logging
from dataclasses import fields
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.locks import only_writer_of_folder
from nsm.cli.progress import Progress
from nsm.cli.settings import morph_times, use_threads
from nsm.evaluate.tables import print_table
from nsm.evaluate.writers import write_evaluations
from nsm.io.loading import LoadedMorph, load_morphs, output_folder
from nsm.metrics import Evaluation, Protocol, evaluate_morph, stages
from nsm.plots.slices import SlicePlane, plot_residual_slices, require_slices
from nsm.plots.strip import try_strip

log = logging.getLogger(__name__)

#: Pictures that are drawn for the morphs of each dimension.
_PICTURES = 2


def main(cfg: DictConfig) -> None:
    """Load morphs, measure them, and write and print the results."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    protocol = Protocol(*(config[field.name] for field in fields(Protocol)))
    times = morph_times("slices.times", config["slices"]["times"])
    plane = SlicePlane(config["slices"]["axis"], config["slices"]["offset"])
    use_threads(config)
    named = load_morphs(config, "nsm.evaluate")
    columns = [column for loaded in named for column in _columns(loaded)]
    by_dim = {
        dim: {column.name: column.morph for column in columns if column.morph.dim == dim}
        for dim in sorted({column.morph.dim for column in columns})
    }
    for morphs in by_dim.values():
        require_slices(morphs, times, plane, "slices.")
    folder = Path(config["output"]) if config["output"] else output_folder(named, "evaluation")
    with only_writer_of_folder(folder), Progress() as progress:
        results = {column.name: _measure(column, protocol, progress) for column in columns}
        files = write_evaluations(folder, {column.name: column.origin for column in columns}, results, protocol)
        progress.stage("drawing", total=_PICTURES * len(by_dim))
        for dim, morphs in by_dim.items():
            suffix = ".png" if len(by_dim) == 1 else f"_{dim}d.png"
            slices, strip = folder / f"slices{suffix}", folder / f"strip{suffix}"
            progress.update(detail="slices")
            plot_residual_slices(slices, morphs, times, plane)
            progress.advance()
            progress.update(detail="strip")
            drawn = try_strip(strip, morphs, size=config["picture_size"])
            progress.advance()
            files += [slices, strip] if drawn else [slices]
    title = (
        f"volume on {protocol.volume_resolution}^d cells at {protocol.times} times, "
        f"ends on {protocol.surface_resolution}^d"
    )
    print_table({name: result.figures() for name, result in results.items()}, title)
    for file in files:
        log.info("wrote %s", file)


def _columns(loaded: LoadedMorph) -> list[LoadedMorph]:
    """A morph, followed by its network alone if it has exact ends."""
    if loaded.network is None:
        return [loaded]
    network = loaded._replace(name=f"{loaded.name} (network)", morph=loaded.network, exact=None, network=None)
    return [loaded, network]


def _measure(column: LoadedMorph, protocol: Protocol, progress: Progress) -> Evaluation:
    progress.stage(column.name, total=stages(column.morph))
    # a stage is done when the next one begins
    begun: list[str] = []

    def begin(stage: str) -> None:
        progress.update(completed=len(begun), detail=stage)
        begun.append(stage)

    flow_error = None if column.exact is None else column.exact.flow_error
    evaluation = evaluate_morph(column.morph, protocol, begin, flow_error)
    progress.update(completed=stages(column.morph), detail="measured")
    return evaluation


if __name__ == "__main__":
    entry.run(main, "evaluate")
