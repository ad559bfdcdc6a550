"""The command that measures: what it writes, where, and what it says when it cannot."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import pytest
from analytic import run_here, save, sentence, shrinking, turning, unreadable

from nsm.evaluate import __main__ as evaluate
from nsm.evaluate.tables import markdown_table, print_table
from nsm.io.loading import load_morphs, output_folder
from nsm.metrics import Protocol, evaluate_morph

SMALL = ("volume_resolution=12", "surface_resolution=12", "times=3", "samples=500", "picture_size=24")


@pytest.fixture(autouse=True)
def _somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _files(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_a_run_is_measured_into_its_own_folder(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "outputs" / "disk"
    morph = shrinking(2, 0.1)
    save(morph, run / "checkpoints" / "best.ckpt")
    assert run_here(evaluate, f"checkpoint={run}", *SMALL) == 0
    written = {"metrics.json", "table.md", "volume.csv", "volume.png", "curves.png", "slices.png", "strip.png"}
    assert _files(tmp_path) == {"outputs/disk/checkpoints/best.ckpt"} | {
        f"outputs/disk/evaluation/{name}" for name in written
    }
    told = json.loads((run / "evaluation" / "metrics.json").read_text())
    assert told["protocol"] == Protocol(12, 12, 3, 500).describe()
    assert set(told["meanings"]) >= {name.split(" t=")[0] for name in told["morphs"]["disk"]["figures"]}
    expected = evaluate_morph(morph, Protocol(12, 12, 3, 500)).to_dict()
    assert told["morphs"]["disk"]["figures"] == pytest.approx(expected["figures"], nan_ok=True)
    assert told["morphs"]["disk"]["origin"] == str(run / "checkpoints" / "best.ckpt")
    rows = list(csv.DictReader((run / "evaluation" / "volume.csv").read_text().splitlines()))
    assert [row["time"] for row in rows] == ["0", "0.5", "1"]
    assert [float(row["volume"]) for row in rows] == pytest.approx(expected["volume"]["volumes"])
    assert [float(row["wanted"]) for row in rows] == pytest.approx([expected["volume"]["volumes"][0]] * 3)
    assert [float(row["error"]) for row in rows] == pytest.approx(expected["volume"]["errors"])
    assert "| volume std | " in (run / "evaluation" / "table.md").read_text()
    shown = capfd.readouterr().out
    assert "volume std" in shown
    assert "evaluation/strip.png" in sentence(shown).replace(" ", "")


def test_several_morphs_share_a_table(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    flat = save(shrinking(2, 0.1), tmp_path / "a" / "checkpoints" / "best.ckpt")
    solid = save(shrinking(3, 0.1), tmp_path / "b" / "checkpoints" / "last.ckpt")
    status = run_here(evaluate, f"checkpoint=[{flat},{solid},{flat}]", "output=results", *SMALL)
    assert status == 0
    assert _files(tmp_path / "results") == {
        "metrics.json", "table.md", "volume.csv", "volume.png", "curves.png",
        "slices_2d.png", "slices_3d.png", "strip_2d.png", "strip_3d.png",
    }  # fmt: skip
    names = list(json.loads((tmp_path / "results" / "metrics.json").read_text())["morphs"])
    assert names == ["a", "b"]
    shown = capfd.readouterr().out
    assert shown.count("gradient norm least") == 1
    assert "…" not in shown


def test_several_morphs_go_into_a_folder_of_their_own(tmp_path: Path) -> None:
    files = [save(shrinking(2, rise), tmp_path / f"{rise}.ckpt") for rise in (0.1, 0.2)]
    subjects = load_morphs(
        {"checkpoint": [str(f) for f in files], "official": None, "growth": None, "ends": "exact"}, "nsm.evaluate"
    )
    assert output_folder(subjects, "evaluation").parts[:2] == ("outputs", "evaluations")
    assert len({subject.name for subject in subjects}) == 2


def test_exact_ends_stand_beside_the_network(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(turning(2, 0.7), tmp_path / "disk" / "checkpoints" / "best.ckpt")
    assert run_here(evaluate, f"checkpoint={file}", "output=results", *SMALL, "surface_resolution=64") == 0
    told = json.loads((tmp_path / "results" / "metrics.json").read_text())["morphs"]
    assert list(told) == ["disk", "disk (network)"]
    exact, network = (morph["figures"] for morph in told.values())
    for t in (0, 1):
        assert exact[f"morph to shape t={t}"] < 1e-4
        assert exact[f"normal error t={t}"] < 0.5
        assert network[f"morph to shape t={t}"] > 0.1
    assert exact["flow map"] < 1e-4
    assert exact["flow map max"] < 1e-3
    assert told["disk"]["flow"]["mean"] == exact["flow map"]
    assert "flow map" not in network
    assert "disk (network)" in capfd.readouterr().out
    assert (tmp_path / "results" / "strip.png").is_file()


def test_the_network_alone(tmp_path: Path) -> None:
    file = save(turning(2, 0.7), tmp_path / "disk" / "checkpoints" / "best.ckpt")
    assert run_here(evaluate, f"checkpoint={file}", "output=results", *SMALL, "ends=network") == 0
    told = json.loads((tmp_path / "results" / "metrics.json").read_text())["morphs"]
    assert list(told) == ["disk"]
    assert told["disk"]["figures"]["morph to shape t=0"] > 0.1


def test_a_narrow_terminal_shows_whole_numbers(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    figures = evaluate_morph(shrinking(2, 0.1), Protocol(12, 12, 3, 500)).figures()
    monkeypatch.setenv("COLUMNS", "64")
    monkeypatch.setenv("FORCE_COLOR", "1")
    print_table({str(n) * 30: figures for n in range(5)}, "five morphs")
    shown = capfd.readouterr().out
    assert shown.count("gradient norm least") == 3
    assert "…" not in shown


def test_the_table_has_a_column_per_morph_and_a_row_per_figure(capfd: pytest.CaptureFixture[str]) -> None:
    morphs: dict[str, dict[str, float | None]] = {
        "ours": {"normal error t=0": 3.21, "volume std": 0.00123, "volume max": 4.56e-6, "most components": 2.0},
        "a|b": {"volume std": None, "speed max/mean": 1.234},
        "theirs": {"carried distance": math.nan},
    }
    print_table(morphs, "three morphs")
    text = capfd.readouterr().out
    assert all(word in text for word in ("three morphs", "ours", "theirs", "volume std", "0.00123", "3.2°", "4.56e-06"))
    assert "carried distance" not in text
    lines = markdown_table(morphs).splitlines()
    assert lines[0] == r"| figure | ours | a\|b | theirs |"
    assert lines[2:] == [
        "| volume std | 0.00123 |  |  |",
        "| volume max | 4.56e-06 |  |  |",
        "| normal error t=0 | 3.2° |  |  |",
        "| speed max/mean |  | 1.23 |  |",
        "| most components | 2 |  |  |",
    ]


def test_the_same_name_is_given_once(tmp_path: Path) -> None:
    files = [save(shrinking(2, 0.1), tmp_path / str(i) / "x" / "run" / "checkpoints" / "best.ckpt") for i in range(3)]
    config = {"checkpoint": [str(f) for f in files], "official": None, "growth": None, "ends": "exact"}
    names = [s.name for s in load_morphs(config, "nsm.evaluate")]
    assert names == ["0/x/run", "1/x/run", "2/x/run"]


def test_a_surface_that_vanishes_is_measured_all_the_same(tmp_path: Path) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "gone.ckpt")
    assert run_here(evaluate, f"checkpoint={file}", *SMALL) == 0
    figures = json.loads((tmp_path / "evaluation" / "metrics.json").read_text())["morphs"]
    (measured,) = figures.values()
    assert measured["figures"]["fewest components"] == 0
    assert measured["figures"]["morph to shape t=1"] is None


def test_a_growth_is_measured_against_itself(tmp_path: Path) -> None:
    file = save(shrinking(2, 0.0), tmp_path / "run" / "checkpoints" / "best.ckpt")
    grow = ("growth=volume_linear", "growth.source=1", "growth.target=2", "volume_resolution=32")
    assert run_here(evaluate, f"checkpoint={file}", "output=results", *SMALL[1:], *grow) == 0
    (told,) = json.loads((tmp_path / "results" / "metrics.json").read_text())["morphs"].values()
    volume = told["volume"]
    assert volume["volumes"][2] / volume["volumes"][0] == pytest.approx(2, rel=0.01)
    assert volume["wanted"] == pytest.approx([volume["volumes"][0] * k for k in (1, 1.5, 2)])
    assert told["figures"]["volume max"] < 0.01


def test_a_slice_that_misses_the_box_is_refused_before_anything_is_measured(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = save(shrinking(3, 0.1), tmp_path / "ball.ckpt")
    assert run_here(evaluate, f"checkpoint={file}", "slices.offset=3", "output=results") == 2
    words = "inside the box of the morph, between -1 and 1, got 3. Try `slices.offset=0`"
    assert f"`slices.offset` must be a coordinate {words}" in sentence(capfd.readouterr().err)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("ailment", ["missing", "cut", "text", "not ours", "format", "no run"])
def test_what_is_no_checkpoint(ailment: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, words = unreadable(tmp_path)[ailment]
    before = _files(tmp_path)
    assert run_here(evaluate, f"checkpoint={file}", "output=results") == 2
    said = sentence(capfd.readouterr().err)
    assert words in said
    assert "Traceback" not in said
    assert _files(tmp_path) == before


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ((), "Try `python -m nsm.evaluate checkpoint=outputs/demo`"),
        (("official=teapot",), "`official` must be one of kitten_fandisk"),
        (("official=kitten_fandisk", "times=1"), "`times` must be an integer of at least 2, got 1"),
        (("official=kitten_fandisk", "times=2.5"), "`times` must be an integer of at least 2, got 2.5"),
        (
            ("official=kitten_fandisk", "volume_resolution=0"),
            "`volume_resolution` must be an integer of at least 8",
        ),
        (("official=kitten_fandisk", "threads=0"), "`threads` must be a positive integer, got 0"),
        (("official=kitten_fandisk", "ends=soft"), "`ends` must be one of exact, network, got soft"),
        (("official=kitten_fandisk", "shell_width=0"), "`shell_width` must be positive and finite, got 0"),
        (("official=kitten_fandisk", "shell_width=wide"), "`shell_width` must be positive and finite, got wide"),
        (("official=kitten_fandisk", "slices.times=[soon]"), "`slices.times` must be a number of times"),
        (("chekpoint=a",), "chekpoint"),
    ],
)
def test_what_cannot_be_measured(
    overrides: tuple[str, ...], words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run_here(evaluate, *overrides) == 2
    assert words in sentence(capfd.readouterr().err)
    assert not _files(tmp_path)
