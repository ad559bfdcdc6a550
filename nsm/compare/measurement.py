"""Measurement of one morph of a study, by a worker of its launcher: requested by a file, kept in another."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import torch
from omegaconf import OmegaConf

import nsm
from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.compare.record import being_carried_out
from nsm.io.loading import PUBLISHED, LoadedMorph, load_published, load_run
from nsm.metrics import Protocol, all_metrics, evaluate_morph

#: Names of the files of a request, as long as it is not fulfilled, and of its result.
_REQUEST, _RESULT = "measure.json", "evaluation.json"


class Measurement(NamedTuple):
    """What is measured of one morph.

    Attributes:
        name: Name of the morph in progress and logs.
        folder: Folder of the run, or of the official morph.
        origin: Checkpoint, or the origin of an official morph.
        ends: Ends of the morph, ``exact`` or ``network``.
        growth: Name of its change of volume.
        protocol: Resolutions and times.
        threads: Threads that measure; None for all cores.
    """

    name: str
    folder: Path
    origin: str
    ends: str
    growth: str
    protocol: Protocol
    threads: int | None

    def key(self) -> dict[str, Any]:
        """What the figures depend on; a measurement with the same key need not be made again."""
        published = self.origin.startswith(PUBLISHED)
        content = self.origin if published else hashlib.sha256(Path(self.origin).read_bytes()).hexdigest()
        # a version with other figures measures again
        names = hashlib.sha256("\n".join(metric.name for metric in all_metrics()).encode()).hexdigest()
        what = {"checkpoint": content, "ends": self.ends, "growth": self.growth, "protocol": self.protocol.describe()}
        return what | {"version": nsm.__version__, "figures": names}

    def result(self) -> dict[str, Any]:
        """Figures that were measured with the same key, or the ``reason`` why there are none; empty if not measured."""
        content = _read(self.folder / _RESULT)
        return content if content.get("key") == self.key() else {}

    def request(self) -> None:
        """Leave the request for a worker.

        Raises:
            InputError: If it cannot be written.
        """
        settings = {name: value for name, value in self._asdict().items() if name != "folder"}
        _write(self.folder / _REQUEST, settings | {"protocol": asdict(self.protocol)})

    def requested(self) -> bool:
        """Whether there is a request that no worker has fulfilled yet."""
        return (self.folder / _REQUEST).is_file()

    def stage(self) -> str | None:
        """The stage that a worker is at; None before it begins and after it ends."""
        return _read(self.folder / _REQUEST).get("stage")


def measure(config: Mapping[str, Any]) -> None:
    """Fulfill the request in the folder ``config["folder"]``: measure a morph, and keep its figures there.

    A morph that cannot be measured is recorded there and not raised. While another worker measures it, this one waits
    for it, and does nothing if it is measured then.

    Args:
        config: Configuration of ``conf/compare_run.yaml``.
    """
    folder = Path(config["folder"])
    with being_carried_out(folder):
        request = _read(folder / _REQUEST)
        if not request:
            return
        settings = {name: request[name] for name in Measurement._fields if name in request}
        asked = Measurement(folder=folder, **settings | {"protocol": Protocol(**settings["protocol"])})
        key = asked.key()
        try:
            result = _measured(asked, lambda stage: _write(folder / _REQUEST, request | {"stage": stage}))
        # one morph must not end the study
        except (InputError, OSError, ValueError, RuntimeError) as error:
            result = {"reason": str(error)}
        _write(folder / _RESULT, {"key": key, **result})
        (folder / _REQUEST).unlink()


def load_measured(name: str, origin: str, ends: str, growth: str) -> LoadedMorph:
    """Load a morph of a study, see `Measurement`."""
    published = origin.removeprefix(PUBLISHED)
    if published != origin:
        return load_published(published)
    config: Any = OmegaConf.to_container(OmegaConf.load(CONF / "growth" / f"{growth}.yaml"))
    return load_run(name, Path(origin), ends, config)


def _measured(asked: Measurement, begin: Callable[[str], object]) -> dict[str, Any]:
    if asked.threads:
        torch.set_num_threads(asked.threads)
    loaded = load_measured(asked.name, asked.origin, asked.ends, asked.growth)
    flow_error = None if loaded.exact is None else loaded.exact.flow_error
    result = evaluate_morph(loaded.morph, asked.protocol, begin, flow_error).to_dict()
    network: dict[str, Any] = {}
    if loaded.network is not None:
        without = evaluate_morph(loaded.network, asked.protocol, lambda stage: begin(f"network, {stage}"))
        network = without.to_dict()["figures"]
    return result | {"network_figures": network}


def _read(file: Path) -> dict[str, Any]:
    """Read a file; one that is missing or was cut is empty."""
    try:
        return dict(json.loads(file.read_text()))
    except (FileNotFoundError, ValueError):
        return {}


def _write(file: Path, content: Mapping[str, Any]) -> None:
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n")
