"""The examples in docstrings run and print what they show."""

from __future__ import annotations

import ast
import doctest
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import nsm

PACKAGE = Path(nsm.__file__).parent
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


class Example(NamedTuple):
    """The docstring of one object that contains an example."""

    module: str
    name: str
    docstring: str


def examples(file: Path) -> Iterator[Example]:
    """Find docstrings with examples in the source: `doctest` overlooks functions that a type checker has wrapped."""
    module = ".".join(("nsm", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")

    def visit(node: ast.AST, name: str) -> Iterator[Example]:
        if isinstance(node, _DOCUMENTED) and ">>>" in (docstring := ast.get_docstring(node) or ""):
            yield Example(module, name, docstring)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, _DOCUMENTED):
                yield from visit(child, f"{name}.{child.name}")

    yield from visit(ast.parse(file.read_text(encoding="utf-8")), module)


EXAMPLES = [example for file in sorted(PACKAGE.rglob("*.py")) for example in examples(file)]


@pytest.mark.parametrize("example", EXAMPLES, ids=[example.name for example in EXAMPLES])
def test_an_example_prints_what_it_shows(example: Example) -> None:
    module = importlib.import_module(example.module)
    parsed = doctest.DocTestParser().get_doctest(example.docstring, dict(vars(module)), example.name, None, None)
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    failed, attempted = runner.run(parsed, out=report.append)
    assert attempted > 0
    assert not failed, "".join(report)


def test_shapes_velocities_and_losses_have_examples() -> None:
    rooms = {".".join(example.module.split(".")[1:2]) for example in EXAMPLES}
    assert {"calculus", "fields", "geometry", "losses", "sampling", "shapes"} <= rooms
