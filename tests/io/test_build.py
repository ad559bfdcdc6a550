"""The instantiator of configs from outside: what it makes, and what it refuses before anything is called."""

from __future__ import annotations

import pytest
from torch import nn

from nsm.cli.errors import InputError
from nsm.fields import Gaussian
from nsm.io.build import build
from nsm.morphs.growth import Growth


def test_only_modules_are_built() -> None:
    built = build({"a": [1, {"_target_": "nsm.fields.Gaussian"}], "b": None})
    assert isinstance(built["a"][1], nn.Module)
    assert built["b"] is None


def test_a_class_of_another_kind_is_not_built() -> None:
    growth = {"_target_": "nsm.morphs.growth.VolumeLinear", "dim": 3}
    assert build(growth, Growth).extremes == (1, 1)
    with pytest.raises(InputError, match="must be a Module of nsm"):
        build(growth)
    with pytest.raises(InputError, match=r"must be a Growth of nsm .*, got 'nsm\.fields\.Gaussian'"):
        build({"_target_": "nsm.fields.Gaussian"}, Growth)


def test_every_name_is_checked_before_the_first_class_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []
    monkeypatch.setattr(Gaussian, "__init__", lambda self, **settings: made.append(self))
    with pytest.raises(InputError, match=r"got 'os\.system'"):
        build([{"_target_": "nsm.fields.Gaussian"}, {"_target_": "os.system", "command": "true"}])
    assert not made
