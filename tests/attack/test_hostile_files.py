"""Hostile files end in one sentence: they run no code, take no memory, and are never read as something else."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import trimesh
from hostile import checkpoint, damaged_meshes, hostile_checkpoints, hostile_networks
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nightly import NIGHTLY, tries
from table import Tally

from nsm.cli.errors import InputError
from nsm.io.checkpoint import load_morph
from nsm.io.shape_file import read_shape
from nsm.shapes.textured import load_textured

#: Every n-th file by day.
_FEW = 1 if NIGHTLY else 9


def test_a_hostile_checkpoint_is_refused(tally: Tally, tmp_path: Path) -> None:
    marker, file = tmp_path / "marker", tmp_path / "a.ckpt"
    for name, content in list(hostile_checkpoints(marker))[::_FEW]:
        with tally.attack("hostile checkpoints"):
            torch.save(content, file)
            with pytest.raises(InputError, match=r"a\.ckpt`"):
                pytest.fail(f"{name} loads as {load_morph(file)}")
            assert not marker.exists(), name


def test_a_hostile_network_is_refused(tally: Tally, tmp_path: Path) -> None:
    marker, file = tmp_path / "marker", tmp_path / "a.pth"
    for name, content in list(hostile_networks(marker))[:: min(_FEW, 3)]:
        with tally.attack("hostile networks"):
            torch.save(content, file)
            with pytest.raises(InputError):
                pytest.fail(f"{name} is read as {read_shape(file)}")
            assert not marker.exists(), name


def test_a_single_bit_that_flips_is_found_or_changes_nothing(tally: Tally, tmp_path: Path) -> None:
    file = tmp_path / "a.ckpt"
    torch.save(checkpoint(), file)
    whole = file.read_bytes()
    expected = load_morph(file).state_dict()
    bits = torch.randint(8 * len(whole), (tries(40, 2000),), generator=torch.Generator().manual_seed(0))
    # 38 bytes into the entry of a part in the directory of the archive: torch takes it for a folder and reads nothing
    folder = 8 * (whole.index(b"PK\x01\x02", whole.index(b"PK\x01\x02") + 1) + 38) + 4
    found = 0
    for bit in [folder, *bits.tolist()]:
        with tally.attack("checkpoints with one bit flipped"):
            flipped = bytearray(whole)
            flipped[bit // 8] ^= 1 << bit % 8
            file.write_bytes(flipped)
            try:
                state = load_morph(file).state_dict()
            except InputError:
                found += 1
            else:
                assert all(torch.equal(value, expected[name]) for name, value in state.items()), bit
    assert found > len(bits) / 10


def test_a_checkpoint_beyond_the_limit_is_refused(
    tally: Tally, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.ckpt"
    torch.save(checkpoint(), file)
    load_morph(file)
    monkeypatch.setattr("nsm.shapes.torch_files.MAX_BYTES", 1000)
    with tally.attack("hostile checkpoints"), pytest.raises(InputError, match="more than"):
        load_morph(file)


def test_a_damaged_file_of_a_shape_is_refused(tally: Tally, tmp_path: Path) -> None:
    for file in list(damaged_meshes(tmp_path))[:: min(_FEW, 3)]:
        with tally.attack("damaged files of shapes"):
            with pytest.raises(InputError):
                pytest.fail(f"{file.name} is read as {read_shape(file)}")
            if file.suffix in (".obj", ".glb"):
                with pytest.raises(InputError):
                    pytest.fail(f"{file.name} is carried as {load_textured(file)}")


_SPHERE = trimesh.creation.icosphere(1)
_OBJ = "".join(f"v {x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in _SPHERE.vertices) + "".join(
    f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in _SPHERE.faces
)
_BINARY = {suffix: bytes(_SPHERE.export(file_type=suffix)) for suffix in ("ply", "stl", "glb")} | {"obj": _OBJ.encode()}


@settings(max_examples=tries(12, 400), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from(sorted(_BINARY)),
    changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=1, max_size=4)), max_size=3),
    length=st.floats(0.5, 1),
)
def test_a_mutated_mesh_is_refused_or_finite(
    suffix: str, changes: list[tuple[float, bytes]], length: float, tally: Tally, tmp_path: Path
) -> None:
    data = bytearray(_BINARY[suffix])
    for place, written in changes:
        start = int(place * len(data))
        data[start : start + len(written)] = written
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(data[: int(length * len(data))])
    with tally.attack("mutated meshes"):
        try:
            shape = read_shape(file)
        except InputError:
            return
        assert bool(shape.bounds().isfinite().all())
        assert 0 < shape.volume() < 1000
