"""A command on a full disk ends in one sentence with status 2, and leaves nothing half-written."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from nightly import NIGHTLY
from table import Tally
from victims import VICTIMS, Victim, files, prepare, require_whole, run

#: Kilobytes that are left on the disk.
LEFT = (0, 4, 12, 32, 80) if NIGHTLY else (12,)
#: Megabytes of the disk.
SIZE = 4


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}m", "tmpfs", str(folder)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount a small disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(disk: Path, left: int) -> None:
    """Leave some kilobytes on a disk."""
    free = shutil.disk_usage(disk).free - left * 1024
    (disk / "filler").write_bytes(bytes(free))


@pytest.mark.parametrize("left", LEFT)
@pytest.mark.parametrize("victim", [v for v in VICTIMS if NIGHTLY or not v.nightly], ids=str)
def test_a_full_disk_is_one_sentence_and_leaves_nothing_half_written(
    victim: Victim, left: int, disk: Path, tmp_path: Path, tally: Tally
) -> None:
    prepare(victim, disk)
    fill(disk, left)
    before = files(disk)
    with tally.attack(f"`{victim}` on a full disk"):
        outcome = run(victim, disk, tmp_path)
        if outcome.status == 0:  # what was left sufficed
            assert files(disk) > before
        else:
            assert outcome.status == 2, outcome.said
            assert "Traceback" not in outcome.said
            assert outcome.said.count("nsm:") == 1, outcome.said
            assert "No space left on device" in outcome.said or "fit on its disk" in outcome.said
        (disk / "filler").unlink()
        require_whole(disk)
        assert not [name for name in files(disk) if "/.nsm-" in f"/{name}" and not name.endswith(".lock")]
        repeated = run(victim, disk, tmp_path)
        assert repeated.status == 0, repeated.said


def test_a_full_disk_of_the_cache_is_blamed_on_the_cache(
    disk: Path, tmp_path: Path, tally: Tally, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NSM_CACHE_DIR", str(disk))
    fill(disk, 4)
    with tally.attack("the cache of fits on a full disk"):
        outcome = run(VICTIMS[0], tmp_path, tmp_path / "said")
        assert outcome.status == 2, outcome.said
        assert "`NSM_CACHE_DIR` must name a folder that can be written" in outcome.said
        assert "No space left on device" in outcome.said
        assert "Traceback" not in outcome.said
        assert files(disk) == {"filler"}
