"""``python -m nsm.compare +study=table9``: methods on pairs of shapes under one budget, compared in one folder."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.locks import only_writer_of_folder
from nsm.cli.progress import Progress
from nsm.compare.launch import launch
from nsm.compare.measurement import Measurement, measure
from nsm.compare.plan import Job, Study, jobs, read_study, trials
from nsm.compare.progress import measuring_progress, training_progress
from nsm.compare.rates import best_rates, finished
from nsm.compare.record import has_ended, prepare
from nsm.compare.report import write_report
from nsm.compare.results import Result, measured, measurement, result_of_official, result_of_run
from nsm.compare.run import carry_out

log = logging.getLogger(__name__)


def main(cfg: DictConfig) -> None:
    """Carry out the runs that are not done yet, evaluate their morphs, and write the report."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    study = read_study(config)
    with only_writer_of_folder(study.folder):
        _carry_out(config, study)


def _carry_out(config: dict[str, Any], study: Study) -> None:
    # all of them, so that an invalid one stops the study before it begins
    trained = {(job.pair, job.method): _trained(job) for job in jobs(study) if job.seed == study.seeds[0]}
    tries = trials(study, [choice for choice, steps in trained.items() if steps])
    try:
        _run_all(study, tries, trained, config["retry"])
        rates = best_rates(tries)
        runs = jobs(study, rates)
        if finished(tries):
            _run_all(study, runs, trained, config["retry"])
        else:
            log.warning("some learning rates are not tried yet; repeat the command to resume")
        results = _results(study, runs)
    except KeyboardInterrupt:
        log.warning("stopped; repeat the command to resume")
        raise
    strip = {"times": config["strip_times"], "size": config["picture_size"]}
    with Progress("writing") as progress:
        files = write_report(study, config, results, tries, strip, lambda part: progress.update(detail=part))
    for result in results:
        if result.reason is not None:
            log.warning("%s/%s: %s", result.pair, result.method, result.reason)
    log.info("wrote %s, and %d more files beside it", files[0], len(files) - 1)


def _run_all(study: Study, runs: Sequence[Job], trained: Mapping[tuple[str, str], bool], retry: bool) -> None:
    """Carry out the runs that are neither done nor failed."""
    for job in runs:
        prepare(job, study.budget, trained[job.pair, job.method], study.threads, retry)
    waiting = [job for job in runs if not has_ended(job.folder)]
    if runs:
        log.info("%d runs, %s each, in %s; %d are left to do", len(runs), study.budget, study.folder, len(waiting))
    with training_progress(waiting):
        launch(carry_out, waiting, lambda job: not has_ended(job.folder), study.folder / "launcher")


def _trained(job: Job) -> bool:
    """Whether a run is trained in steps, by its composed configuration; one that does not compose raises here."""
    composed = GlobalHydra.instance().config_loader().load_configuration("train", list(job.overrides), RunMode.RUN)
    return bool(composed.task.kind == "morph")


def _results(study: Study, runs: Sequence[Job]) -> list[Result]:
    """Measure the morph of every run, and the official ones."""
    found = [(result_of_run(study, job), job.folder) for job in runs]
    found += [result_of_official(study, pair) for pair in study.pairs if study.official]
    asked = [measurement(study, result, folder) for result, folder in found]
    waiting = [each for each in asked if each is not None and "figures" not in each.result()]
    for each in waiting:
        each.request()
    with measuring_progress(waiting):
        launch(measure, waiting, Measurement.requested, study.folder / "launcher")
    return [result if each is None else measured(result, each) for (result, _), each in zip(found, asked, strict=True)]


if __name__ == "__main__":
    entry.run(main, "compare")
