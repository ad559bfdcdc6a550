"""Public files by name: found, verified, and reported when missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from nsm.cli.errors import InputError
from nsm.shapes.download import Entry, fetch, file_sha256, manifest, resolve


@pytest.fixture
def one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A manifest of one file, whose copy lies under NSM_DATA_DIR, and no network."""
    path = tmp_path / "data" / "meshes" / "a.obj"
    path.parent.mkdir(parents=True)
    path.write_text("v 0 0 0\n")
    entry = Entry("meshes/a.obj", 8, file_sha256(path), "http://127.0.0.1:9/a.obj")
    monkeypatch.setattr("nsm.shapes.download.manifest", lambda: {entry.path: entry})
    monkeypatch.setenv("NSM_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return path


def test_a_copy_is_found(one_file: Path) -> None:
    assert fetch("meshes/a.obj") == one_file
    assert resolve("meshes/a.obj") == one_file
    assert resolve(str(one_file)) == one_file


def test_a_wrong_copy_is_refused(one_file: Path) -> None:
    one_file.write_text("v 0 0 1\n")
    with pytest.raises(InputError, match="must have the SHA-256 checksum"):
        fetch("meshes/a.obj")


def test_a_missing_file_is_named_with_its_address(one_file: Path) -> None:
    one_file.unlink()
    with pytest.raises(InputError, match=r"http://127.0.0.1:9/a.obj .* \$NSM_DATA_DIR/meshes/a.obj"):
        fetch("meshes/a.obj")


def test_unknown_names(one_file: Path) -> None:
    with pytest.raises(InputError, match=r"got meshes/b\.obj. Try `meshes/a\.obj`"):
        fetch("meshes/b.obj")
    with pytest.raises(InputError, match=r"must be an existing file or a public name, got nothing\.xyz"):
        resolve("nothing.xyz")
    with pytest.raises(InputError, match="`path` must be a file, got the folder"):
        resolve(one_file.parent)


def test_the_manifest_is_complete() -> None:
    assert len(manifest()) > 20
    assert all(len(e.sha256) == 64 and e.url.startswith("https://") for e in manifest().values())
