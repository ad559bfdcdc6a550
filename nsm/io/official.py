"""The morphs that the authors of the method trained and published.

Their files (https://github.com/camillebnm/neural_shape_morphing) are bare state dicts without ω, architecture, end
shapes, or scale. Comparison with the published shapes determined what is missing, and `PAIRS` records it:

- No pair was scaled to equal volumes: at both ends every f fits the published signed distances best without a scale.
  (The volumes of four pairs agree to 0.2 %; those of spot and bob differ by 5 %, those of feline and horse by 8 %.)
- ``bust-max`` goes from max to bust, and ``twist`` from pave to twist.
- ``best_V.pth`` of aligned_feline-horse is not a velocity, but the network f again, with its weights divided by 60.
  There V is ``weights_V.pth``, with which the level set equation holds as well as for the other pairs.
- Feline and horse lie on their sides in their files. Their networks are turned, so that all morphs are upright here.
- Every surface stays inside [−1, 1]^3 at the times that were checked (t = 0, ¼, ½, ¾, 1), so this is the box of each
  morph.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from nsm import calculus
from nsm.cli.errors import InputError
from nsm.cli.settings import nearest
from nsm.fields import AdaDiv, ScalarSiren, Siren, VectorSiren
from nsm.fields.beta import Gaussian
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import FieldShape, SirenFile, fetch
from nsm.shapes.siren_file import OFFICIAL_OMEGA, read_layers, set_layers_

#: ω of the published f, whose weights already include it.
FOLDED_OMEGA = 1.0
#: α of the authors' β(s) = 1 − exp(−α s²).
ALPHA = 0.1
#: Tolerance of the mean difference between f and its end shapes near them. The published morphs differ by at most
#: 0.007, and by at least 0.02 if ω is 10 % off.
_ENDS_TOLERANCE = 0.015
#: Tolerance of the mean |∂f/∂t + ⟨∇f, V⟩| near the surface, relative to the mean |∂f/∂t|. The published pairs have at
#: most 0.23 (twist, which hardly moves: 0.66); a V that is unrelated to f has 1.
_LEVEL_SET_TOLERANCE = 0.8
#: Distance that counts as near, cells of the grid, and number of points for both checks.
_NEAR, _GRID, _POINTS = 0.05, 48, 6000


class Pair(NamedTuple):
    """Facts about a published morph that its files do not contain.

    Attributes:
        folder: Folder in ``official/morphs``.
        source: Name of the shape at t = 0 in ``official/ni``.
        target: Name of the shape at t = 1 in ``official/ni``.
        velocity: Name of the file of V.
        velocity_omega: ω of V.
        up: Direction in the coordinates of the files that becomes +y; None for +y.
        pose: Rotation by quarter turns after that, which keep the box.
    """

    folder: str
    source: str
    target: str
    velocity: str = "best_V.pth"
    velocity_omega: float = OFFICIAL_OMEGA
    up: tuple[float, ...] | None = None
    pose: Mapping[str, Any] | None = None


#: Published morphs by the names of our experiments; `official_name` also accepts the names of their folders.
PAIRS = {
    "kitten_fandisk": Pair("kitten-fandisk", "kitten", "fandisk"),
    "spot_bob": Pair("spot-bob", "spot", "bob", "weights_V.pth", 30.0),
    "cylinders_torus": Pair("cylinder-torus", "cylinder", "torus"),
    "feline_horse": Pair(
        "aligned_feline-horse",
        "aligned_feline",
        "horse",
        "weights_V.pth",
        up=(0, 0, 1),
        pose={"rotation": [0, 90, 0]},
    ),
    "bust_max": Pair("bust-max", "max_new", "bust", "weights_V.pth", 30.0),
    "twist": Pair("twist", "pave", "twist"),
}


def official_name(name: str) -> str:
    """Find the key of `PAIRS` for a name, which is the key itself or the name of its folder.

    Raises:
        InputError: If no morph of that name was published.

    Example:
        >>> official_name("aligned_feline-horse")
        'feline_horse'
    """
    folders = {pair.folder: key for key, pair in PAIRS.items()}
    if name in PAIRS or name in folders:
        return folders.get(name, name)
    near = nearest(name, [*PAIRS, *folders])
    raise InputError(
        f"`official` must be one of {', '.join(PAIRS)}, got {name}. Try `official={near or next(iter(PAIRS))}`."
    )


def load_official(
    name: str,
    omega: float = FOLDED_OMEGA,
    velocity_omega: float | None = None,
    ends_omega: float = OFFICIAL_OMEGA,
    alpha: float = ALPHA,
) -> NeuralMorph:
    """Load a published morph from ``NSM_DATA_DIR``, or download it and verify its checksum.

    Args:
        name: Key of `PAIRS`, or the name of its folder.
        omega: ω of f.
        velocity_omega: ω of V, by default that of the pair.
        ends_omega: ω of the two end shapes.
        alpha: α of β(s) = 1 − exp(−α s²).

    Raises:
        InputError: If there is no such morph, its files are missing, or the networks do not fit together at these ω.
    """
    pair = PAIRS[official_name(name)]
    folder = f"official/morphs/{pair.folder}"
    files = (f"official/ni/{end}.pth" for end in (pair.source, pair.target))
    source, target = (SirenFile(file, ends_omega, pair.pose, pair.up) for file in files)
    chosen = pair.velocity_omega if velocity_omega is None else velocity_omega
    field, velocity = fetch(f"{folder}/best.pth"), fetch(f"{folder}/{pair.velocity}")
    return read_morph(field, velocity, source, target, chosen, omega, alpha)


def read_morph(
    field_file: Path,
    velocity_file: Path,
    source: FieldShape,
    target: FieldShape,
    velocity_omega: float,
    omega: float = FOLDED_OMEGA,
    alpha: float = ALPHA,
) -> NeuralMorph:
    """Read a morph that the authors' code wrote: f(x, t), and V = curl D + β(f) ∇u from one network of outputs (u, D).

    Args:
        field_file: State dict of f.
        velocity_file: State dict of the network of V.
        source: Shape at t = 0. It may be turned from the coordinates of its file; the morph is then turned like it.
        target: Shape at t = 1, turned in the same way.
        velocity_omega: ω of V.
        omega: ω of f.
        alpha: α of β(s) = 1 − exp(−α s²).

    Raises:
        InputError: If a file is not such a network, f differs from its end shapes, or V does not advect f.
    """
    dim = source.dim
    layers = read_layers(field_file, inputs=(dim + 1,))
    field = ScalarSiren(dim + 1, *_size(layers), omega)
    layers_v = read_layers(velocity_file, inputs=(dim + 1,), outputs=1 + calculus.potential_count(dim))
    width, depth = _size(layers_v)
    network = partial(VectorSiren, hidden_features=width, hidden_layers=depth, omega=velocity_omega)
    velocity = AdaDiv(dim, network, Gaussian(alpha))
    set_layers_(field, layers)
    set_layers_(velocity.network, layers_v)
    _turn_(field, source.similarity.rotation)
    _turn_(velocity.network, source.similarity.rotation)
    morph = NeuralMorph(field, velocity, source, target).eval().requires_grad_(False)
    _require_ends(morph, field_file, omega)
    _require_level_set_equation(morph, velocity_file, velocity_omega)
    return morph


@torch.no_grad()
def _turn_(network: Siren, rotation: Tensor) -> None:
    """Turn a network of (x, t): a scalar g becomes g(Rᵀ x, t), and a vector D in 3D after the scalar R D(Rᵀ x, t).

    Then ∇u and curl D turn like D. In 2D, the potential is a scalar, too.
    """
    first, last = network.linear_layers[0], network.linear_layers[-1]
    rotation, dim = rotation.to(first.weight), len(rotation)
    first.weight[:, :dim] = first.weight[:, :dim] @ rotation.T
    if dim == 3:
        for part in (last.weight[1:], last.bias[1:]):
            if len(part):  # those of D
                part.copy_(rotation @ part)


def _size(layers: list[Tensor]) -> tuple[int, int]:
    """Width and number of hidden layers."""
    return layers[0].shape[0], len(layers) // 2 - 1


@torch.no_grad()
def _require_ends(morph: NeuralMorph, file: Path, omega: float) -> None:
    grid = _grid(morph)
    for time, shape in ((0.0, morph.source), (1.0, morph.target)):
        expected = torch.cat([shape(chunk) for chunk in grid.split(1 << 15)])
        near = expected.abs() < _NEAR
        difference = float((morph(grid[near], time) - expected[near]).abs().mean())
        if not difference < _ENDS_TOLERANCE:
            raise InputError(
                f"{file} must be the end shape at t = {time:g}, got a difference of {difference:.2g} near its "
                f"surface with `omega={omega:g}`. Try `omega={FOLDED_OMEGA:g}`, or the shapes that it was trained with."
            )


@torch.no_grad()
def _require_level_set_equation(morph: NeuralMorph, file: Path, omega: float) -> None:
    x = _grid(morph)
    t = torch.rand(len(x), generator=torch.Generator().manual_seed(0))
    near = morph(x, t).abs() < _NEAR
    x, t = x[near][:: max(1, int(near.sum()) // _POINTS)], t[near][:: max(1, int(near.sum()) // _POINTS)]
    gradient, velocity = morph.jet(x, t).gradient, morph.velocity(x, t)
    assert velocity is not None  # an AdaDiv was just made
    rate = gradient[:, morph.dim]
    residual = rate + (gradient[:, : morph.dim] * velocity).sum(1)
    share = float(residual.abs().mean() / rate.abs().mean())
    if not share < _LEVEL_SET_TOLERANCE:
        raise InputError(
            f"{file} must be a velocity that advects f, got a residual of {share:.0%} of ∂f/∂t in the level set "
            f"equation with `velocity_omega={omega:g}`. Try `velocity_omega={OFFICIAL_OMEGA:g}`, or 30 for spot-bob "
            "and bust-max."
        )


def _grid(morph: NeuralMorph) -> Tensor:
    axes = [torch.linspace(float(low), float(high), _GRID) for low, high in morph.bounds.T]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, morph.dim)
