"""Error messages in the source have one form, whether or not a test provokes them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from errors import has_form

import nsm

PACKAGE = Path(nsm.__file__).parent


def messages() -> list[tuple[str, int, str]]:
    """Module, line, and text of every message in the source, with an ellipsis for each value in it."""
    found = []
    for file in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "InputError":
                found += [(module, node.lineno, text(argument)) for argument in node.args]
    return found


def text(node: ast.expr) -> str:
    """The text of a literal, of an f-string, or of a sum of them; every other expression is an ellipsis."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(map(text, node.values))
    if isinstance(node, ast.IfExp):
        return text(node.body)
    if isinstance(node, ast.BinOp):
        return text(node.left) + text(node.right)
    return "…"


def test_every_message_in_the_source_has_the_form() -> None:
    # a message that ends in another one only says where that one came up
    own = [message for message in messages() if not message[2].endswith(": …")]
    wrong = [f"{module}:{line}: {said}" for module, line, said in own if not has_form(said)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("message", "right"),
    [
        ("`steps` must be a positive integer, got 0. Try `steps=3900`.", True),
        ("steps=0 cannot be: give a number", False),
        ("`steps` must be a positive integer, got 0.", False),
        ("The number must be positive, got 0. Try 1.", False),
    ],
)
def test_the_form(message: str, right: bool) -> None:
    assert has_form(message) == right
