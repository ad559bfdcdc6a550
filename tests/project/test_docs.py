"""What README and docs tell people to type works."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from analytic import save, turning
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from runs import composed

import nsm
from nsm.calculus import divergence
from nsm.cli.configuration import CONF
from nsm.compare.plan import read_study
from nsm.fields import VectorSiren
from nsm.geometry.volume import volume
from nsm.losses import Term
from nsm.metrics.metric import MorphMetric
from nsm.types import Jet

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
#: Pages whose code needs nothing but a run in outputs/demo.
RUNNABLE = ["concepts.md", "README.md", "index.md", "library.md"]
COMMAND = re.compile(
    r"^(?:nsm |python -m nsm\.)(train|evaluate|export|render|view|layers|compare)\b(.*)$", re.MULTILINE
)


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def commands() -> Iterator[Any]:
    for page in PAGES:
        for block in blocks(page, ""):
            for name, rest in COMMAND.findall(block):
                yield pytest.param(name, shlex.split(rest, comments=True), id=f"{page.name}: {name}{rest}")


def single(overrides: list[str]) -> list[str]:
    """The first run of a sweep."""
    return [re.sub(r"^(\+?[^=]+)=(\[[^\]]*\]|[^,\[]*),.*$", r"\1=\2", override) for override in overrides]


@pytest.mark.parametrize(("name", "overrides"), list(commands()))
def test_every_command_is_understood(name: str, overrides: list[str]) -> None:
    overrides = [override for override in overrides if override not in {"-m", "…"}]
    if name == "train":
        assert composed(*single(overrides)).steps > 0
        return
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose(name, overrides)
    if name == "layers":
        assert str(config.inner) != str(config.outer) or config.inner_label != config.outer_label
    elif name == "compare":
        assert read_study(OmegaConf.to_container(config, resolve=True)).methods
    elif name != "view" or overrides:  # the viewer alone waits for files
        assert str(config.checkpoint).startswith("outputs/")


def test_the_commands_are_those_of_the_package() -> None:
    page = (ROOT / "docs" / "commands.md").read_text()
    shown = {name for name, _ in COMMAND.findall(page)}
    assert shown == {"train", "evaluate", "export", "render", "view", "layers", "compare"}


def test_the_make_targets_are_there() -> None:
    makefile = (ROOT / "Makefile").read_text()
    wanted = {target for page in PAGES for target in re.findall(r"^make (\w+)", page.read_text(), re.MULTILINE)}
    assert {"demo", "test", "lint", "docs"} <= wanted
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in wanted)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_files_that_a_page_shows_and_names_are_there(page: Path) -> None:
    text = page.read_text()
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    for name in re.findall(r"\]\(((?!http|#)[^)#]+)", prose):
        assert (page.parent / name).exists(), name
    for name in re.findall(r"\bpython ((?:tools|examples)/\S+\.py)", text):
        assert (ROOT / name).is_file(), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_names_of_the_package_that_a_page_mentions_are_there(page: Path) -> None:
    for name in re.findall(r"`nsm\.(?!json`)([A-Za-z_]\w*)\(?[^`]*`", page.read_text()):  # nsm.json is a file
        assert name in nsm.__all__ or (ROOT / "nsm" / name).exists() or (ROOT / "nsm" / f"{name}.py").exists(), name


@pytest.mark.parametrize("page", [page for page in PAGES if page.name in RUNNABLE], ids=lambda page: page.name)
def test_the_code_of_a_page_runs_on_a_finished_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(turning(3, 0.1), tmp_path / "outputs" / "demo" / "checkpoints" / "best.ckpt")
    monkeypatch.chdir(tmp_path)
    snippets = blocks(page, "python")
    assert snippets
    for snippet in snippets:
        exec(snippet, {})  # our own pages


@pytest.fixture(scope="module")
def extended() -> dict[str, Any]:
    """The names that the code of docs/extending.md defines."""
    names: dict[str, Any] = {}
    for snippet in blocks(ROOT / "docs" / "extending.md", "python"):
        exec(snippet, names)  # our own page
    return names


def test_the_velocity_of_the_docs_has_the_divergence_that_it_gives(extended: dict[str, Any]) -> None:
    network = partial(VectorSiren, hidden_features=8, hidden_layers=1, omega=3.0)
    velocity = extended["Rotation"](2, network).double()
    p, f = torch.rand(9, 3, dtype=torch.double), Jet(torch.zeros(9).double(), torch.zeros(9, 3).double())
    field = lambda q: velocity(q[None], f)[0]  # noqa: E731
    jacobian = torch.func.vmap(torch.func.jacrev(field))(p)
    torch.testing.assert_close(velocity.divergence(p, f), divergence(jacobian[:, :, :2]))


def test_the_loss_term_of_the_docs_is_one(extended: dict[str, Any]) -> None:
    assert issubclass(extended["Speed"], Term)


def test_the_metric_of_the_docs_is_one(extended: dict[str, Any]) -> None:
    assert isinstance(extended["final"], MorphMetric)


def test_the_shape_of_the_docs_is_a_signed_distance_with_its_volume(extended: dict[str, Any]) -> None:
    shape = extended["Stadium"](0.4, 0.2)
    x = 2 * torch.rand(200, 2) - 1
    jet = shape.jet(x)
    torch.testing.assert_close(jet.gradient.norm(dim=1), torch.ones(200))
    assert volume(shape, shape.local_box(), 256) == pytest.approx(shape.volume(), rel=1e-4)
    points = shape.surface_samples(50, torch.Generator().manual_seed(0)).points
    torch.testing.assert_close(shape(points), torch.zeros(50), atol=1e-5, rtol=0)


def test_the_files_of_the_docs_name_the_classes_of_the_docs(extended: dict[str, Any]) -> None:
    text = (ROOT / "docs" / "extending.md").read_text()
    configs = [yaml.safe_load(block) for block in blocks(ROOT / "docs" / "extending.md", "yaml")]
    targets = re.findall(r"_target_: ([\w.]+)", text)
    assert len(configs) == len(targets) == 3
    assert {target.rpartition(".")[2] for target in targets} <= set(extended)


def test_every_page_is_in_the_navigation() -> None:
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    named = set(re.findall(r"[\w/]+\.md", str(site["nav"])))
    there = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert named == there
