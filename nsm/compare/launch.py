"""Work of a study, given to the workers of Hydra's launcher as jobs of ``conf/compare_run.yaml``."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.types import HydraContext
from omegaconf import OmegaConf, open_dict

from nsm.cli.overrides import literal
from nsm.compare.record import being_carried_out

log = logging.getLogger(__name__)


@runtime_checkable
class Work(Protocol):
    """Work that a worker does in a folder, from what it finds there."""

    @property
    def folder(self) -> Path:
        """The folder."""


W = TypeVar("W", bound=Work)


def launch(
    task: Callable[[Mapping[str, Any]], object], waiting: Sequence[W], left: Callable[[W], bool], folder: Path
) -> None:
    """Have work done, and begin again what is left where a worker was lost, as long as some is finished each time.

    Args:
        task: Does the work in the folder ``config["folder"]``, in the process of a worker.
        waiting: The work.
        left: Whether some work is not finished.
        folder: Folder for what the launcher writes.
    """
    while waiting:
        _launch_once(task, waiting, folder)
        before, waiting = waiting, [work for work in waiting if left(work)]
        if len(waiting) == len(before):
            break


def _launch_once(task: Callable[[Mapping[str, Any]], object], waiting: Sequence[W], folder: Path) -> None:
    config: Any = copy.deepcopy(HydraConfig.instance().cfg)
    for node in (config, config.hydra, config.hydra.job):
        OmegaConf.set_readonly(node, False)
    with open_dict(config):
        config.hydra.job.config_name = "compare_run"
        config.hydra.overrides.hydra = []
        config.hydra.sweep.dir = str(folder.resolve())
    launcher = Plugins.instance().instantiate_launcher(
        hydra_context=HydraContext(config_loader=GlobalHydra.instance().config_loader(), callbacks=Callbacks()),
        task_function=task,
        config=config,
    )
    # Hydra lists every job; progress shows the active ones
    for name in ("hydra", "hydra_plugins"):
        logging.getLogger(name).setLevel(logging.WARNING)
    try:
        launcher.launch([[f"folder={literal(str(work.folder.resolve()))}"] for work in waiting], initial_job_idx=0)
    # each launcher raises an error of its own when a worker is lost; work that is done still counts
    except Exception as error:
        log.warning("a worker was lost: %s", " ".join(str(error).split()) or type(error).__name__)
    for work in waiting:
        with being_carried_out(work.folder):  # other workers go on
            pass
