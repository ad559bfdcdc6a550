"""The fields of a morph for programs that do not have nsm: weights with a description, and compiled programs.

Three formats, all in single precision and for any number of points:

    safetensors  the weights, and JSON that says what to do with them (docs/inference.md has a reader of 40 lines)
    pt2          a program of torch.export
    onnx         a program of ONNX, for onnxruntime and what else reads it

The programs take ``points`` (n, d) and ``time`` (n,), and give ``signed_distance`` (n,), its spatial ``gradient``
(n, d) and, where the morph has one, ``velocity`` (n, d).
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import torch
from jaxtyping import Float
from safetensors.torch import save_file
from torch import Tensor, nn

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.fields import Beta, LearnedVelocity, LipschitzMlp, ScalarNetwork, Siren, Velocity
from nsm.morphs.growth import Grown, Growth
from nsm.morphs.neural import NeuralMorph
from nsm.types import Morph

#: Raised whenever a reader of older files could no longer read them.
FORMAT = 1
#: Where the description stands in each file.
DESCRIPTION = "nsm.json"
#: Points on which a program is traced; any number but 0 and 1, which are taken as they are.
_TRACED_POINTS = 8
#: Between the layers of each kind of network.
_ACTIVATIONS: dict[type[nn.Module], str] = {Siren: "sin", LipschitzMlp: "tanh"}
_OUTPUTS = ("signed_distance", "gradient", "velocity")


class Fields(nn.Module):
    """f, ∇f and V of a morph as one function of points and times.

    Args:
        field: f.
        velocity: V, or None.
    """

    def __init__(self, field: ScalarNetwork, velocity: Velocity | None) -> None:
        super().__init__()
        self.field, self.velocity = field, velocity

    def forward(self, points: Float[Tensor, "n d"], time: Float[Tensor, " n"]) -> tuple[Tensor, ...]:
        """f (n,), ∇f (n, d) and, where there is one, V (n, d)."""
        p = torch.cat([points, time[:, None]], 1)
        jet = self.field.jet(p)
        outputs = (jet.value, jet.gradient[:, : points.shape[1]])
        return outputs if self.velocity is None else (*outputs, self.velocity(p, jet))


class GrownFields(nn.Module):
    """The same for a morph whose volume changes: α f(x/α, t), ∇f(x/α, t) and α V(x/α, t) + (α'/α) x.

    Args:
        fields: at constant volume.
        growth: α.
    """

    def __init__(self, fields: Fields, growth: Growth) -> None:
        super().__init__()
        self.fields, self.growth = fields, growth

    def forward(self, points: Float[Tensor, "n d"], time: Float[Tensor, " n"]) -> tuple[Tensor, ...]:
        """f (n,), ∇f (n, d) and, where there is one, V (n, d)."""
        scale, rate = self.growth.scale(time), self.growth.rate(time)
        value, gradient, *velocity = self.fields(points / scale[:, None], time)
        carried = tuple(scale[:, None] * V + (rate / scale)[:, None] * points for V in velocity)
        return (scale * value, gradient, *carried)


def fields_of(morph: Morph) -> Fields | GrownFields:
    """The fields of a morph in single precision on the CPU, ω folded into the weights.

    Raises:
        InputError: if it is not made of networks.
    """
    if isinstance(morph, Grown):
        inner = fields_of(morph.morph)
        assert isinstance(inner, Fields)  # what grows has a constant volume
        return GrownFields(inner, morph.growth)
    copied = deepcopy(_networks(morph)).float().cpu().eval().requires_grad_(False)
    fields = Fields(copied.field, copied.velocity_field)
    for module in fields.modules():
        if isinstance(module, Siren):
            folded = module.layers
            module.omegas = [1.0] * module.hidden_layers
            module.load_layers(folded)
    return fields


def description(morph: Morph) -> dict[str, Any]:
    """What a morph is, in plain values: dimension, box, networks with ω, β, and where its shapes come from.

    Raises:
        InputError: if it is not made of networks.
    """
    grown = isinstance(morph, Grown)
    network = _networks(morph.morph if isinstance(morph, Grown) else morph)
    velocity = network.velocity_field
    described: dict[str, Any] | None = None
    if velocity is not None:
        described = {"kind": type(velocity).__name__, **_numbers(velocity)}
        if isinstance(velocity, LearnedVelocity):
            described["network"] = _architecture(velocity.network)
        if isinstance(beta := getattr(velocity, "beta", None), Beta):
            described["beta"] = {"kind": type(beta).__name__, **_numbers(beta)}
    return {
        "format": FORMAT,
        "nsm": nsm.__version__,
        "dim": morph.dim,
        "bounds": morph.bounds.tolist(),
        "inputs": {"points": ["n", morph.dim], "time": ["n"]},
        "outputs": list(_OUTPUTS if velocity else _OUTPUTS[:2]),
        "grown": grown,
        "field": _architecture(network.field),
        "velocity": described,
        "source": network.source.provenance(),
        "target": network.target.provenance(),
    }


def write_safetensors(path: Path | str, morph: Morph) -> None:
    """Write the weights of f and V as safetensors, with `description` as JSON in its metadata under ``nsm.json``.

    ``field.0.weight`` (out, in), ``field.0.bias`` (out,), … and ``velocity.0.weight``, … are those of the layers from
    the first to the last, ω folded in, in float32: h ↦ sin(W h + b), or another ``activation``, and W h + b at the end.

    Raises:
        InputError: if a part of the morph is no network of its own (a volume that changes, a velocity made of f), or
            the file cannot be written.
    """
    network = _networks(morph.morph if isinstance(morph, Grown) else morph)
    velocity = network.velocity_field
    if isinstance(morph, Grown) or not isinstance(velocity, LearnedVelocity | None):
        what = "a volume that changes" if isinstance(morph, Grown) else f"the velocity {type(velocity).__name__}"
        raise InputError(
            f"format=safetensors holds weights, and {what} is none of them: "
            + ("give growth=none, or " if isinstance(morph, Grown) else "give ")
            + "format=pt2 or format=onnx, which compute it"
        )
    parts = {"field": network.field} | ({} if velocity is None else {"velocity": velocity.network})
    weights = {
        f"{part}.{number // 2}.{('weight', 'bias')[number % 2]}": layer.detach().float().cpu().contiguous()
        for part, owner in parts.items()
        for number, layer in enumerate(_layered(owner).layers)
    }
    with whole_file(path) as temporary:
        save_file(weights, temporary, metadata={DESCRIPTION: json.dumps(description(morph))})


def write_pt2(path: Path | str, morph: Morph) -> None:
    """Write the fields as a program of torch.export; `description` is its extra file ``nsm.json``.

    Raises:
        InputError: if the morph is not made of networks, or the file cannot be written.
    """
    program = _traced(morph)
    with whole_file(path) as temporary:
        torch.export.save(program, temporary, extra_files={DESCRIPTION: json.dumps(description(morph))})


def write_onnx(path: Path | str, morph: Morph) -> None:
    """Write the fields as an ONNX model; `description` stands in its metadata under ``nsm.json``.

    Raises:
        InputError: if onnx or onnxscript is not installed, the morph is not made of networks, or the file cannot be
            written.
    """
    if missing := [name for name in ("onnx", "onnxscript") if find_spec(name) is None]:
        raise InputError(
            f"format=onnx is written by {' and '.join(missing)}, which is not installed: pip install 'nsm[onnx]'"
        )
    program = _traced(morph)
    described = description(morph)
    names = {"input_names": ["points", "time"], "output_names": described["outputs"]}
    try:
        with _quietly(), torch.no_grad():
            made = torch.onnx.export(program, dynamo=True, verbose=False, **names)
    except torch.onnx.OnnxExporterError as error:
        raise InputError(
            "ONNX has no operation for a part of this morph (a growth by a table is such a part): give format=pt2"
        ) from error
    assert made is not None  # as it is with dynamo=True
    made.model.metadata_props[DESCRIPTION] = json.dumps(described)
    with whole_file(path) as temporary:
        made.save(temporary)


def _networks(morph: Morph) -> NeuralMorph:
    if not isinstance(morph, NeuralMorph):
        raise InputError(
            f"{type(morph).__name__} is not made of networks, so there are no fields to write: give a trained morph"
        )
    return morph


def _layered(network: nn.Module) -> Siren | LipschitzMlp:
    if not isinstance(network, tuple(_ACTIVATIONS)):
        raise InputError(
            f"a {type(network).__name__} has no layers that another program could read: give a morph of sine networks"
        )
    return cast("Siren | LipschitzMlp", network)


def _architecture(network: nn.Module) -> dict[str, Any]:
    layered = _layered(network)
    widths = [layered.layers[0].shape[1], *(len(bias) for bias in layered.layers[1::2])]
    activation = next(name for kind, name in _ACTIVATIONS.items() if isinstance(network, kind))
    return {
        "kind": type(network).__name__,
        "widths": widths,
        "activation": activation,
        # what was folded into the weights
        "omega": list(layered.omegas) if isinstance(layered, Siren) else None,
    }


def _numbers(module: nn.Module) -> dict[str, float]:
    values: Mapping[str, Any] = vars(module)
    return {name: value for name, value in values.items() if isinstance(value, float)}


@torch.no_grad()
def _traced(morph: Morph) -> torch.export.ExportedProgram:
    """The fields as a graph of plain operations, for any number of points."""
    fields = fields_of(morph)
    points, time = torch.rand(_TRACED_POINTS, morph.dim), torch.rand(_TRACED_POINTS)
    fields(points, time)  # constants that the calculus keeps must be made before tracing, or they are made of nothing
    n = torch.export.Dim("n")
    program = torch.export.export(fields, (points, time), dynamic_shapes={"points": {0: n}, "time": {0: n}})
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # paths of this machine
    return program


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep back what the exporter says about packages and constants that nobody asked for."""
    logs = [logging.getLogger(name) for name in ("torch.onnx", "onnx_ir", "onnxscript")]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)
