"""What the tests of commands, pages, and the library have in common."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from nsm.morphs import exact_ends


@pytest.fixture(autouse=True, scope="module")
def _coarse_tables_of_exact_ends() -> Iterator[None]:
    """These tests are of what is written where; how exact the ends are is tested with the morphs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact_ends, "FLOW_RESOLUTION", {2: 16, 3: 8})
        patch.setattr(exact_ends, "DETAIL_RESOLUTION", {2: 64, 3: 32})
        yield
