"""Layers of equal volume: exact radii of balls, exact columns between confocal ellipsoids, and the command."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from analytic import run_here, sentence
from folders import names, read_mesh
from scipy.optimize import brentq

from nsm.geometry.layers import Columns, equal_volume_surfaces
from nsm.geometry.topology import enclosed_volume
from nsm.layers import __main__ as layers
from nsm.shapes import Ball, Box
from nsm.types import SimplexMesh

FRACTIONS = (0.1, 0.5, 0.9)


def directions(dim: int, count: int) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.randn(count, dim, dtype=torch.float64), dim=1)


@pytest.mark.parametrize("dim", [2, 3])
def test_layers_between_balls_have_the_exact_radii(dim: int) -> None:
    low, high, errors = 0.5, 0.9, []
    center = torch.tensor([3.0, -2.0, 1.0][:dim], dtype=torch.float64)
    inner, outer = Ball(low, center.tolist()), Ball(high, center.tolist())
    for resolution in (14, 28):
        points = center + low * directions(dim, 500)
        columns = Columns(points, inner, outer, outer.exact_bounds(), resolution)
        error = 0.0
        for fraction in (0.0, *FRACTIONS, 1.0):
            radii = (columns.at(fraction) - center).norm(dim=1)
            exact = (low**dim + fraction * (high**dim - low**dim)) ** (1 / dim)
            error = max(error, float((radii - exact).abs().max()))
        errors.append(error / (2 * high / resolution))
    assert errors[0] < 0.1  # of a cell, with a shell of three cells
    assert errors[1] < 0.6 * errors[0]  # at least of second order


class Spheroid:
    """The part of space inside of a confocal ellipse or prolate spheroid with foci at ±c on the first axis.

    Its points are x = c cosh μ cos ν and ρ = c sinh μ sin ν, with the distance ρ from the axis, and it is {μ < m}.
    μ − m, and in 3D a function of μ alone, is harmonic up to a scale, so that lines of ∇h have constant ν.
    """

    def __init__(self, dim: int, focus: float, rim: float) -> None:
        self.dim, self.focus, self.rim = dim, focus, rim

    def coordinates(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """μ and ν, both (n,)."""
        across = x[:, 1:].norm(dim=1)
        far, near = ((x[:, 0] + sign * self.focus).square() + across**2 for sign in (1, -1))
        cosh = (far.sqrt() + near.sqrt()) / (2 * self.focus)
        cos = (far.sqrt() - near.sqrt()) / (2 * self.focus)
        return torch.acosh(cosh.clamp(min=1)), torch.acos(cos.clamp(-1, 1))

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """The distance to first order, (μ − m) times the length of a unit of μ, which is exact on the surface."""
        mu, nu = self.coordinates(x)
        return (mu - self.rim) * self.focus * (math.sinh(self.rim) ** 2 + nu.sin() ** 2).sqrt()

    def points(self, nu: torch.Tensor, turn: torch.Tensor) -> torch.Tensor:
        across = self.focus * math.sinh(self.rim) * nu.sin()
        around = [across] if self.dim == 2 else [across * turn.cos(), across * turn.sin()]
        return torch.stack([self.focus * math.cosh(self.rim) * nu.cos(), *around], 1)

    def below(self, mu: float, nu: float) -> float:
        """Volume of a thin column at ν below μ, up to a factor."""
        if self.dim == 2:
            return math.sinh(2 * mu) / 2 - math.cos(2 * nu) * mu
        return math.cosh(mu) ** 3 / 3 - math.cosh(mu) + math.sin(nu) ** 2 * math.cosh(mu)


@pytest.mark.parametrize("dim", [2, 3])
def test_every_column_between_confocal_ellipsoids_is_divided_exactly(dim: int) -> None:
    inner, outer = Spheroid(dim, 0.6, 0.5), Spheroid(dim, 0.6, 1.1)
    nu, turn = 0.2 + 2.7 * torch.rand(40).double(), 6.28 * torch.rand(40).double()
    half = outer.focus * torch.tensor([math.cosh(1.1), *[math.sinh(1.1)] * (dim - 1)]).double()
    errors, linear = [], 0.0
    for resolution in (18, 36):
        columns = Columns(inner.points(nu, turn), inner, outer, torch.stack([-half, half]), resolution)
        error = 0.0
        for fraction in (*FRACTIONS, 1.0):
            mu, found = outer.coordinates(columns.at(fraction))
            error = max(error, float((found - nu).abs().max()))  # along a line of ∇h
            for height, angle in zip(mu.tolist(), nu.tolist(), strict=True):
                low, high = (inner.below(rim, angle) for rim in (inner.rim, outer.rim))
                exact = brentq(lambda m: inner.below(m, angle) - low - fraction * (high - low), 0.4, 1.2)  # noqa: B023
                error = max(error, abs(height - exact))
                linear = max(linear, abs(inner.rim + fraction * (outer.rim - inner.rim) - exact))
        errors.append(error)
    assert errors[1] < 0.01  # a unit of μ is 0.3 to 1 in length, and a cell is 0.056
    assert errors[1] < 0.4 * errors[0]  # second order
    assert linear > 0.05  # levels of h itself are far from it


@pytest.mark.parametrize("dim", [2, 3])
def test_columns_into_a_deep_bay_end_on_its_walls(dim: int) -> None:
    """A narrow tube leaves a shell of balls: lines of ∇h fade away in it, and end on its walls all the same."""
    inner, ball = Ball(0.3, [0.0] * dim), Ball(0.4, [0.0] * dim)
    tube = Box([0.6] + [0.16] * (dim - 1), [0.6] + [0.0] * (dim - 1))
    outer = lambda x: torch.minimum(ball(x), tube(x))  # noqa: E731
    points = 0.3 * directions(dim, 300)
    bounds = torch.tensor([[-0.4] * dim, [1.1] + [0.4] * (dim - 1)]).double()
    columns = Columns(points, inner, outer, bounds, 40)
    assert columns.lost.double().mean() < 0.01
    ends = columns.at(1.0)[~columns.lost]
    assert outer(ends).abs().max() < 1e-3
    assert (outer(columns.at(0.5)) < 1e-3).all()
    assert ends[:, 0].max() > 0.45


def test_layers_of_any_ellipsoids_have_the_exact_volume() -> None:
    ball = trimesh.creation.icosphere(3)
    inner_half, outer_half = np.array([0.5, 0.4, 0.6]), np.array([0.9, 0.6, 0.75])

    def ellipsoid(half: np.ndarray):
        h = torch.from_numpy(half)

        def field(x: torch.Tensor) -> torch.Tensor:
            scaled = (x.double() / h).norm(dim=1)
            return scaled * (scaled - 1) / (x.double() / h**2).norm(dim=1).clamp(min=1e-9)

        return field

    mesh = SimplexMesh(torch.from_numpy(ball.vertices * inner_half), torch.from_numpy(ball.faces.copy()))
    bounds = torch.from_numpy(np.stack([-outer_half, outer_half]))
    both = ellipsoid(inner_half), ellipsoid(outer_half)
    surfaces = equal_volume_surfaces(mesh, *both, bounds, [*FRACTIONS, 1.0], 32)
    volumes = [enclosed_volume(surface) for surface in surfaces]
    flat = ball.volume / (4 / 3 * math.pi)  # the part of an ellipsoid's volume that these triangles enclose
    low, high = (4 / 3 * math.pi * half.prod() * flat for half in (inner_half, outer_half))
    assert volumes[-1] == pytest.approx(high, rel=0.005)
    for fraction, volume in zip(FRACTIONS, volumes, strict=False):
        assert volume == pytest.approx(low + fraction * (high - low), rel=0.005)


@pytest.fixture
def shells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, radius in (("white", 30.0), ("pial", 36.0)):
        ball = trimesh.creation.icosphere(3, radius)
        ball.apply_translation([100, -20, 55])
        ball.export(tmp_path / f"{name}.ply")
    return tmp_path


def test_the_command_divides_two_meshes_in_the_coordinates_of_their_files(
    shells: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run_here(layers, "inner=white.ply", "outer=pial.ply", "layers=3", "resolution=24", "output=o") == 0
    assert names(shells / "o") == ["layers.json", *(f"surface_000{n}.ply" for n in range(4))]
    record = json.loads((shells / "o" / "layers.json").read_text())["surfaces"]
    flat = (trimesh.creation.icosphere(3).volume / (4 / 3 * math.pi)) ** (1 / 3)
    for number, entry in enumerate(record):
        assert entry["fraction"] == pytest.approx(number / 3)
        assert entry["share"] == pytest.approx(number / 3, abs=0.01)
        mesh = read_mesh(shells / "o" / entry["file"])
        assert mesh.volume == pytest.approx(entry["volume"], rel=1e-4)
        radii = np.linalg.norm(np.asarray(mesh.vertices) - [100, -20, 55], axis=1)
        # the triangles lie a little inside of both balls, so that the vertices do as well
        assert radii == pytest.approx((30**3 + number / 3 * (36**3 - 30**3)) ** (1 / 3), abs=0.25 + 36 * (1 - flat))
    assert "wrote 2 surfaces and the two of the shell to o" in sentence(capfd.readouterr().out)


def test_the_example_of_the_docs_gives_the_radii_that_they_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).resolve().parents[2] / "docs" / "outputs.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(code, {})  # our own page
    (command,) = re.findall(r"^nsm layers (inner=white.*)$", page, re.MULTILINE)
    assert run_here(layers, *command.split()) == 0
    for number, radius in ((1, 32.25), (2, 34.23)):
        mesh = read_mesh(tmp_path / "layers" / f"surface_000{number}.ply")
        assert f"{radius}" in page
        radii = np.linalg.norm(mesh.vertices, axis=1)
        assert radii == pytest.approx(radius, abs=0.2)  # between two polyhedra
        assert radii.mean() == pytest.approx(radius, abs=0.05)


def test_chosen_fractions_between_two_regions_of_a_volume(shells: Path) -> None:
    nibabel = pytest.importorskip("nibabel")
    away = np.linalg.norm(np.argwhere(np.ones([40] * 3)) - 19.5, axis=1).reshape([40] * 3)
    labels = np.where(away < 11, 2, np.where(away < 17, 3, 0)).astype(np.uint8)
    nibabel.save(nibabel.Nifti1Image(labels, np.diag([2.0, 2.0, 2.0, 1.0])), shells / "a.nii.gz")
    command = ("inner=a.nii.gz", "inner_label=2", "outer=a.nii.gz", "outer_label=[2,3]", "layers=[0.5]", "format=obj")
    assert run_here(layers, *command, "resolution=20") == 0
    half = read_mesh(shells / "outputs" / "layers" / "a.nii" / "surface_0001.obj")
    radii = np.linalg.norm(np.asarray(half.vertices) - 39, axis=1)
    assert radii == pytest.approx(2 * ((11**3 + 17**3) / 2) ** (1 / 3), abs=0.6)  # a third of a voxel


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("inner=null",), "`inner` must be the file of a surface, got nothing"),
        (("inner=pial.ply", "outer=white.ply"), "`outer` must enclose `inner`"),
        (("inner=none.ply",), "none.ply"),
        (("inner=cloud.xyz",), "which holds points"),
        (("layers=1",), "`layers` must be an integer of at least 2, got 1"),
        (("layers=[]",), "`layers` must be a number of layers or a list of fractions"),
        (("layers=[0.5,0.2]",), "`layers` must be a list of increasing numbers"),
        (("layers=[0.5,1]",), "`layers` must be a number between 0 and 1, got 1"),
        (("resolution=2",), "`resolution` must be an integer of at least 8"),
        (("format=glb",), "`format` must be one of ply, obj, stl, got glb"),
    ],
)
def test_what_cannot_be_divided(
    overrides: tuple[str, ...], words: str, shells: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(shells / "cloud.xyz", trimesh.creation.icosphere(3, 30.0).vertices)
    before = names(shells)
    assert run_here(layers, "inner=white.ply", "outer=pial.ply", "resolution=8", *overrides) == 2
    assert words in sentence(capfd.readouterr().err)
    assert names(shells) == before
