"""Fixtures of studies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from studies import forked

from nsm.compare import run


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders of the runs that were started, by forking."""
    folders: list[Path] = []

    def note(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        folders.append(log.parent)
        return forked(arguments, log, threads)

    monkeypatch.setattr(run, "_start", note)
    return folders
