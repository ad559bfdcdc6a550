"""Initial weights of f(x, t)."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch

from nsm.cli.errors import InputError
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.siren import ScalarSiren


class FieldInit(ABC):
    """A rule that sets the initial weights of f(x, t), possibly from a network g(x) of the source.

    Attributes:
        needs_source: Whether the rule needs g.
    """

    needs_source: bool = True

    @abstractmethod
    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        """Set the weights of ``field`` in place.

        Args:
            field: The network f(x, t).
            source: A network g(x) of the same width and depth fitted to the source; ignored if not needed.
        """

    def require(self, field: ScalarNetwork) -> None:
        """Require a network that the rule can initialize.

        Raises:
            InputError: If f has no sine activations, which all rules but `OwnInit` need.
        """
        if not isinstance(field, ScalarSiren):
            raise InputError(f"`init` must be own for a {type(field).__name__}, got another rule. Try `init=own`.")


class SirenInit(FieldInit):
    """Random weights as drawn by `Siren.reset_parameters`."""

    needs_source = False

    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        field.reset_parameters()


class SourceInit(FieldInit):
    """Weights with which f(x, t) = g(x) exactly, so that training starts from a source at rest.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren, SourceInit
        >>> field, source = ScalarSiren(4, 16, 2), ScalarSiren(3, 16, 2)
        >>> SourceInit()(field, source)
        >>> x, t = torch.rand(5, 3), torch.rand(5, 1)
        >>> torch.allclose(field(torch.cat([x, t], dim=1)), source(x), atol=1e-5)
        True
    """

    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        _copy_scaled(field, source, 1.0)


class OfficialInit(FieldInit):
    """The weights of g with all frequencies lowered, as in the code of the paper's authors.

    Args:
        factor: Ratio of the new to the old frequencies. The authors read networks of ω = 60 with ω = 15.
    """

    def __init__(self, factor: float = 0.25) -> None:
        self.factor = float(factor)

    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        _copy_scaled(field, source, self.factor)


class OwnInit(FieldInit):
    """The weights that the network drew when it was constructed."""

    needs_source = False

    def require(self, field: ScalarNetwork) -> None:
        """Accept any network."""

    def __call__(self, field: ScalarNetwork, source: ScalarSiren | None) -> None:
        pass


def _copy_scaled(field: ScalarSiren, source: ScalarSiren | None, factor: float) -> None:
    """Copy the layers of g into f with hidden layers scaled, and zero weights for the additional input t."""
    wanted = (field.hidden_features, field.hidden_layers)
    found = None if source is None else (source.hidden_features, source.hidden_layers)
    if source is None or found != wanted:
        raise ValueError(
            f"`source` must be a network of the same width and depth as f, {wanted}, got {found}. Try `SirenInit()`."
        )
    *hidden, weight, bias = source.layers
    hidden = [factor * parameter for parameter in hidden]
    hidden[0] = torch.cat([hidden[0], hidden[0].new_zeros(len(hidden[0]), 1)], 1)
    field.load_layers((*hidden, weight, bias))
