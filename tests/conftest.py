"""What every test stands on: shapes and types checked at run time, fixed seeds, few threads, the official data."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from errors import has_form
from hypothesis import settings
from jaxtyping import install_import_hook

# Must precede the first import of the package: every function in it then checks its annotations when called.
install_import_hook("nsm", "run_time_types.check")

torch.set_num_threads(1)

# The first example pays for imports and thread pools; a deadline would only make the suite depend on the machine.
settings.register_profile("nsm", deadline=None, derandomize=True)
settings.load_profile("nsm")


@pytest.fixture(autouse=True)
def _same_randomness_in_every_test() -> None:
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 (libraries draw from the global generator)
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def _errors_have_one_form(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every error for users that a test provokes has the form of `errors.py`."""
    from nsm.cli.errors import InputError  # only now, as the package must be imported after the hook

    provoked: list[str] = []

    def record(self: InputError, message: str) -> None:
        ValueError.__init__(self, message)
        if sys._getframe(1).f_globals["__name__"].startswith("nsm."):
            provoked.append(message)

    monkeypatch.setattr(InputError, "__init__", record)
    yield
    wrong = [message for message in provoked if not has_form(message)]
    assert not wrong, "messages without the form of all errors (tests/errors.py): " + "; ".join(wrong)


@pytest.fixture
def generator() -> torch.Generator:
    """A freshly seeded source of random numbers for what takes one."""
    return torch.Generator().manual_seed(0)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of official networks and meshes that NSM_DATA_DIR names; without it the test is skipped."""
    folder = os.environ.get("NSM_DATA_DIR")
    if not folder:
        pytest.skip("needs the official data: set NSM_DATA_DIR to the folder that holds official/ and meshes/")
    path = Path(folder).expanduser().resolve()
    if not path.is_dir():
        pytest.fail(f"NSM_DATA_DIR is {folder}, which is no folder: name the one that holds official/ and meshes/")
    return path
