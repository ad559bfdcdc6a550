"""The penalty of Lipschitz networks (Liu et al., SIGGRAPH 2022, eq. 7)."""

from __future__ import annotations

from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.lipschitz import LipschitzMlp
from nsm.losses.base import Evaluation, Term


class LipschitzBound(Term):
    """The learned bound on the Lipschitz constant of f, as small as the data allow."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        if not isinstance(evaluation.field, LipschitzMlp):
            raise InputError(
                f"loss.terms.lipschitz asks for a bound that {type(evaluation.field).__name__} does not have: choose "
                "field=lipschitz"
            )
        return evaluation.field.bound[None]
