"""Values in the grammar of overrides."""

from __future__ import annotations

from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hypothesis import given
from hypothesis import strategies as st

from nsm.cli.overrides import literal

texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]))
plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts
PARSER = OverridesParser.create()


def parsed(override: str) -> Any:
    def texts_as_such(value: Any) -> Any:
        if isinstance(value, list):
            return list(map(texts_as_such, value))
        return value.text if isinstance(value, QuotedString) else value

    return texts_as_such(PARSER.parse_override(override).value())


@given(plain | st.lists(plain))
def test_hydra_reads_back_what_was_written(value: Any) -> None:
    assert parsed(f"key={literal(value)}") == value
