"""``python -m nsm.compare +study=table9``: methods on pairs of shapes under one budget, compared in one folder."""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import torch
from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from nsm.cli import entry
from nsm.cli.locks import only_writer_of_folder
from nsm.cli.overrides import literal
from nsm.cli.progress import Progress
from nsm.compare.plan import Job, Study, jobs, read_study, trials
from nsm.compare.progress import study_progress
from nsm.compare.rates import best_rates, finished
from nsm.compare.record import DONE, FAILED, prepare, read_record
from nsm.compare.report import write_report
from nsm.compare.results import Result, result_of_official, result_of_run
from nsm.compare.run import being_carried_out, carry_out

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
    records = [prepare(job, study.budget, trained[job.pair, job.method], study.threads, retry) for job in runs]
    waiting = [job for job, record in zip(runs, records, strict=True) if record.state not in (DONE, FAILED)]
    if runs:
        log.info("%d runs, %s each, in %s; %d are left to do", len(runs), study.budget, study.folder, len(waiting))
    if waiting:
        _launch(study, waiting)


def _trained(job: Job) -> bool:
    """Whether a run is trained in steps, by its composed configuration; one that does not compose raises here."""
    composed = GlobalHydra.instance().config_loader().load_configuration("train", list(job.overrides), RunMode.RUN)
    return bool(composed.task.kind == "morph")


def _launch(study: Study, waiting: Sequence[Job]) -> None:
    """Carry out runs, and those that are left where a worker was lost, as long as some are finished each time."""
    left: Sequence[Job] = waiting
    while left:
        before, left = left, _launch_once(study, left)
        if len(left) == len(before):
            break


def _launch_once(study: Study, waiting: Sequence[Job]) -> list[Job]:
    """Carry out runs with Hydra's launcher, each as a job of ``conf/compare_run.yaml``; returns those that are left."""
    config: Any = copy.deepcopy(HydraConfig.instance().cfg)
    for node in (config, config.hydra, config.hydra.job):
        OmegaConf.set_readonly(node, False)
    with open_dict(config):
        config.hydra.job.config_name = "compare_run"
        config.hydra.overrides.hydra = []
        config.hydra.sweep.dir = str((study.folder / "launcher").resolve())
    launcher = Plugins.instance().instantiate_launcher(
        hydra_context=HydraContext(config_loader=GlobalHydra.instance().config_loader(), callbacks=Callbacks()),
        task_function=carry_out,
        config=config,
    )
    # Hydra lists every job; progress shows the active ones
    for name in ("hydra", "hydra_plugins"):
        logging.getLogger(name).setLevel(logging.WARNING)
    with study_progress(waiting):
        try:
            launcher.launch([[f"folder={literal(str(job.folder.resolve()))}"] for job in waiting], initial_job_idx=0)
        # each launcher raises an error of its own when a worker is lost; runs that are done still count
        except Exception as error:
            log.warning("a worker was lost: %s", " ".join(str(error).split()) or type(error).__name__)
        for job in waiting:
            with being_carried_out(job.folder):  # other workers go on
                pass
    return [job for job in waiting if (record := read_record(job.folder)) and record.state not in (DONE, FAILED)]


def _results(study: Study, runs: Sequence[Job]) -> list[Result]:
    """Evaluate every run, and the official morphs."""
    if study.threads:
        torch.set_num_threads(study.threads)
    evaluations = [partial(result_of_run, study, job) for job in runs]
    evaluations += [partial(result_of_official, study, pair) for pair in study.pairs if study.official]
    results = []
    with Progress("measuring", total=len(evaluations), unit="morphs") as progress:
        for evaluation in evaluations:
            results.append(evaluation(progress=lambda stage: progress.update(detail=stage)))
            progress.advance()
    return results


if __name__ == "__main__":
    entry.run(main, "compare")
