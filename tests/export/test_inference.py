"""Fields for programs that do not have nsm: each format, read without it, gives what the morph gives."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx
import pytest
import torch
from analytic import shrinking
from problems import MOTIONS
from safetensors import safe_open

from nsm.cli.errors import InputError
from nsm.export.network_format import DESCRIPTION
from nsm.export.onnx import write_onnx
from nsm.export.pt2 import write_pt2
from nsm.export.safetensors import write_safetensors
from nsm.fields import AdaDiv, Free, Gaussian, LipschitzMlp, Nise, NullDiv, Quartic, ScalarSiren, VectorSiren
from nsm.morphs.growth import Grown, SmoothStep, Table
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball

READER = Path(__file__).resolve().parents[2] / "docs" / "inference.md"
SMALL = partial(VectorSiren, hidden_features=9, hidden_layers=2, omega=4.0)
VELOCITIES = {
    "adadiv": lambda dim: AdaDiv(dim, SMALL, Gaussian(0.8)),
    "quartic": lambda dim: AdaDiv(dim, SMALL, Quartic(0.5)),
    "nulldiv": lambda dim: NullDiv(dim, SMALL),
    "free": lambda dim: Free(dim, SMALL),
    "none": lambda dim: None,
}


def small_morph(dim: int, velocity: str = "adadiv") -> NeuralMorph:
    field = ScalarSiren(dim + 1, 11, 3, omega=[2.0, 7.0, 5.0])
    ends = (Ball(0.4, [0.0] * dim), Ball(0.5, [0.0] * dim))
    return NeuralMorph(field, VELOCITIES[velocity](dim), *ends).requires_grad_(False)


def tanh_morph(dim: int) -> NeuralMorph:
    ends = (Ball(0.4, [0.0] * dim), Ball(0.5, [0.0] * dim))
    return NeuralMorph(LipschitzMlp(dim + 1, 9, 3), Free(dim, SMALL), *ends).requires_grad_(False)


def expected(morph, points: np.ndarray, time: np.ndarray) -> dict[str, np.ndarray]:
    x, t = torch.from_numpy(points), torch.from_numpy(time)
    velocity = morph.velocity(x, t)
    answers = {"signed_distance": morph(x, t), "gradient": morph.gradient(x, t)}
    answers |= {} if velocity is None else {"velocity": velocity}
    return {name: value.numpy() for name, value in answers.items()}


def somewhere(dim: int, count: int, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    points = random.uniform(-1, 1, (count, dim)).astype(np.float32)
    time = random.uniform(0, 1, count).astype(np.float32)
    np.savez(folder / "asked.npz", points=points, time=time)
    return points, time


def elsewhere(folder: Path, code: str) -> dict[str, np.ndarray]:
    """What a program without nsm answers to asked.npz."""
    code = (
        "import sys; sys.modules['nsm'] = None\nimport numpy as np\n"
        f"asked = np.load('asked.npz'); points, time = asked['points'], asked['time']\n{code}\n"
        "np.savez('answer.npz', **{f'{i}': np.asarray(a) for i, a in enumerate(answer) if a is not None})\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    with np.load(folder / "answer.npz") as answer:
        names = ("signed_distance", "gradient", "velocity")
        return {name: answer[str(i)] for i, name in enumerate(names) if str(i) in answer}


def require_same(answer: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> None:
    assert set(answer) == set(wanted)
    for name, values in wanted.items():
        assert answer[name].shape == values.shape
        assert np.abs(answer[name] - values).max() < 1e-5, name


def reader() -> str:
    """The code of the documentation."""
    blocks = re.findall(r"```python\n(.*?)```", READER.read_text(), re.DOTALL)
    return next(block for block in blocks if "def load" in block)


PT2 = """
import torch
program = torch.export.load('m.pt2').module()
answer = program(torch.from_numpy(points), torch.from_numpy(time))
"""
ONNX = """
import onnxruntime
session = onnxruntime.InferenceSession('m.onnx')
assert [i.name for i in session.get_inputs()] == ['points', 'time']
assert [o.name for o in session.get_outputs()] == ['signed_distance', 'gradient', 'velocity']
answer = session.run(None, {'points': points, 'time': time})
assert 'torch' not in sys.modules
"""
SAFETENSORS = """
answer = fields(*load('m.safetensors'), points.astype(np.float64), time)
assert 'torch' not in sys.modules
"""


class Written(NamedTuple):
    morph: NeuralMorph
    folder: Path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """One morph in all formats."""
    torch.manual_seed(0)
    morph, folder = small_morph(3), tmp_path_factory.mktemp("written")
    for name, write in (("safetensors", write_safetensors), ("pt2", write_pt2), ("onnx", write_onnx)):
        write(folder / f"m.{name}", morph)
    return Written(morph, folder)


@pytest.mark.parametrize("code", [reader() + SAFETENSORS, PT2, ONNX], ids=["safetensors", "pt2", "onnx"])
def test_each_format_gives_the_fields_without_nsm(written: Written, code: str) -> None:
    asked = somewhere(3, 37, written.folder)
    require_same(elsewhere(written.folder, code), expected(written.morph, *asked))


@pytest.mark.parametrize(
    "morph",
    [
        small_morph(2, "quartic"),
        small_morph(3, "nulldiv"),
        small_morph(2, "free"),
        small_morph(3, "none"),
        tanh_morph(3),
    ],
    ids=["quartic", "nulldiv", "free", "none", "tanh"],
)
def test_the_reader_of_the_documentation_knows_all_networks(tmp_path: Path, morph: NeuralMorph) -> None:
    write_safetensors(tmp_path / "m.safetensors", morph)
    asked = somewhere(morph.dim, 50, tmp_path)
    require_same(elsewhere(tmp_path, reader() + SAFETENSORS), expected(morph, *asked))


def test_a_growth_is_part_of_the_program() -> None:
    grown = Grown(small_morph(3), SmoothStep(3, 1.0, 1.7))
    program = grown.networks().program
    for count in (1, 20):
        x, t = torch.rand(count, 3) - 0.5, torch.rand(count)
        for answer, wanted in zip(
            program(x, t), (grown(x, t), grown.gradient(x, t), grown.velocity(x, t)), strict=True
        ):
            assert torch.allclose(answer, wanted, atol=1e-5)


def test_what_is_written_does_not_change_the_morph(written: Written, tmp_path: Path) -> None:
    assert written.morph.field.omegas == [2.0, 7.0, 5.0]
    x, t = torch.rand(9, 3), torch.rand(9)
    folded = written.morph.networks().program
    assert torch.allclose(folded(x, t)[2], written.morph.velocity(x, t), atol=1e-6)
    assert all(not parameter.requires_grad for parameter in folded.parameters())
    write_safetensors(tmp_path / "m.safetensors", written.morph)
    assert (tmp_path / "m.safetensors").read_bytes() == (written.folder / "m.safetensors").read_bytes()


def test_all_formats_say_the_same_about_the_morph(written: Written) -> None:
    about = written.morph.networks().description
    assert about["bounds"] == [[-1, -1, -1], [1, 1, 1]]
    assert about["field"]["widths"] == [4, 11, 11, 11, 1]
    assert about["field"]["omega"] == [2.0, 7.0, 5.0]
    assert about["velocity"]["beta"] == {"kind": "Gaussian", "alpha": 0.8}
    assert about["source"]["kind"] == "ball"
    with safe_open(written.folder / "m.safetensors", "np") as file:
        assert json.loads(file.metadata()[DESCRIPTION]) == about
    extra = {DESCRIPTION: ""}
    torch.export.load(written.folder / "m.pt2", extra_files=extra)
    assert json.loads(extra[DESCRIPTION]) == about
    model = onnx.load(written.folder / "m.onnx")
    assert {entry.key: json.loads(entry.value) for entry in model.metadata_props} == {DESCRIPTION: about}
    # nothing about the machine that wrote it
    assert str(READER.parent.parent).encode() not in (written.folder / "m.onnx").read_bytes()


def test_what_cannot_be_written_is_said(tmp_path: Path) -> None:
    grown = Grown(small_morph(2), SmoothStep(2, 1.0, 1.5))
    with pytest.raises(InputError, match=r"a changing volume.* Try `format=onnx` or `growth=none`\."):
        write_safetensors(tmp_path / "m.safetensors", grown)
    normal = NeuralMorph(small_morph(2).field, Nise(2), Ball(0.4, [0.0] * 2), Ball(0.5, [0.0] * 2))
    with pytest.raises(InputError, match=r"the velocity Nise.* Try `format=onnx`\."):
        write_safetensors(tmp_path / "m.safetensors", normal)
    with pytest.raises(InputError, match=r"must be given a morph that ONNX has operations for, .* Try `format=pt2`"):
        write_onnx(tmp_path / "m.onnx", Grown(shrinking(2, 0.1), Table(2, [0, 0.5, 1], [1.0, 1.2, 0.9])))
    with pytest.raises(InputError, match=r"must be made of networks .*, got LinearMotion"):
        write_pt2(tmp_path / "m.pt2", MOTIONS["rotating_box"](2))
    assert not list(tmp_path.iterdir())


def test_onnx_is_not_needed_for_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(InputError, match=r"needs `onnxscript`, .* Try `pip install 'nsm\[onnx\]'`\.$"):
        write_onnx(tmp_path / "m.onnx", small_morph(2))
