"""Morphs of a study, measured by the workers of its launcher."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import cloudpickle
import pytest
from studies import Lost, compare_here, rows, tiny

from nsm.compare import __main__ as compare
from nsm.compare import launch, measurement
from nsm.compare.measurement import Measurement, load_measured, measure
from nsm.io.checkpoint import find_checkpoint
from nsm.metrics import Protocol, evaluate_morph

PROTOCOL = Protocol(16, 16, 3, 500)


@pytest.fixture
def study(tmp_path: Path, started: list[Path]) -> tuple[str, ...]:
    """A study of one run, with its morph measured."""
    command = tiny(tmp_path, "methods=[adadiv]")
    assert compare_here(*command) == 0
    return command


def folder_of(output: Path) -> Path:
    return output / "runs" / "disk_translation" / "adadiv"


def measurement_in(output: Path) -> Measurement:
    folder = folder_of(output)
    return Measurement("disk", folder, str(find_checkpoint(folder)), "network", "none", PROTOCOL, 1)


def test_a_measurement_keeps_the_figures_of_the_morph_and_takes_the_request_away(
    study: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = measurement_in(tmp_path)
    assert asked.result()["figures"], "the study measured just that"
    other = asked._replace(protocol=Protocol(16, 16, 4, 500))
    assert not other.result()
    other.request()
    assert other.requested()
    assert other.stage() is None
    stages, write = [], measurement._write
    monkeypatch.setattr(measurement, "_write", lambda *rest: (write(*rest), stages.append(other.stage())))
    measure({"folder": str(other.folder)})
    assert "volume over time" in stages
    assert not other.requested()
    morph = load_measured("disk", other.origin, "network", "none").morph
    expected = evaluate_morph(morph, other.protocol).to_dict()
    assert other.result()["figures"] == json.loads(json.dumps(expected["figures"]))
    assert len(other.result()["volume"]["times"]) == 4
    assert not asked.result(), "one result is kept"
    measure({"folder": str(other.folder)})  # nothing is asked for


def test_a_morph_that_cannot_be_measured_is_a_row_with_the_reason_and_tried_again(
    study: tuple[str, ...], tmp_path: Path
) -> None:
    found = rows(tmp_path)["adadiv"]
    for file in (folder_of(tmp_path) / "checkpoints").glob("*.ckpt"):
        file.rename(file.with_suffix(".kept"))
        file.write_bytes(b"no checkpoint")
    assert compare_here(*study) == 0
    reason = rows(tmp_path)["adadiv"]["reason"]
    assert reason.startswith("its morph could not be measured: ")
    assert "best.ckpt" in reason
    for file in (folder_of(tmp_path) / "checkpoints").glob("*.kept"):
        file.replace(file.with_suffix(".ckpt"))
    assert compare_here(*study) == 0
    assert rows(tmp_path)["adadiv"] == found


def test_a_worker_that_is_lost_while_it_measures_does_not_end_the_study(
    study: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launch.Plugins, "instantiate_launcher", lambda self, **rest: Lost())
    assert compare_here(*study, "times=4") == 0
    assert rows(tmp_path)["adadiv"]["reason"] == "its morph could not be measured; repeat the command to measure it"
    monkeypatch.undo()
    assert compare_here(*study, "times=4") == 0
    assert rows(tmp_path)["adadiv"]["reason"] is None


def measure_and_sign(config: Any) -> None:
    """Measure, and leave behind which process did."""
    import os
    from pathlib import Path

    from nsm.compare.measurement import measure

    measure(config)
    (Path(config["folder"]) / "signed").write_text(str(os.getpid()))


def test_morphs_are_measured_by_the_workers_of_a_launcher(
    study: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers cannot import tests
    monkeypatch.setattr(compare, "measure", measure_and_sign)
    monkeypatch.chdir(tmp_path.parent)
    try:
        assert compare_here(*study, "times=4", f"output={tmp_path.name}", "hydra/launcher=workers") == 0
    finally:
        cloudpickle.unregister_pickle_by_value(sys.modules[__name__])
    assert len(rows(tmp_path)["adadiv"]["volume"]["times"]) == 4
    assert int((folder_of(tmp_path) / "signed").read_text()) != os.getpid()
