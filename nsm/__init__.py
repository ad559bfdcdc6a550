"""nsm: volume-preserving neural shape morphing.

>>> from nsm import load_morph
>>> morph = load_morph("outputs/demo")  # doctest: +SKIP
>>> morph(x, 0.5)                       # signed distances (n,) at points x (n, d), half way  # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nsm.cli.runtime import share_cores

if TYPE_CHECKING:
    from nsm.io.checkpoint import load_morph
    from nsm.morphs.exact_ends import ExactEnds

share_cores()  # before anything imports torch

__version__ = "0.1.0"
__all__ = ["ExactEnds", "__version__", "load_morph"]


def __getattr__(name: str) -> Any:
    # resolved on first use, so that `import nsm.types` does not import everything
    if name == "load_morph":
        from nsm.io.checkpoint import load_morph

        return load_morph
    if name == "ExactEnds":
        from nsm.morphs.exact_ends import ExactEnds

        return ExactEnds
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
