"""Initializations of f."""

from __future__ import annotations

import pytest
import torch
from hydra.utils import instantiate
from runs import composed

from nsm.cli.configuration import CONF
from nsm.fields import (
    LipschitzMlp,
    OfficialInit,
    OwnInit,
    ScalarSiren,
    SirenInit,
    SourceInit,
)

INITS = sorted(p.stem for p in (CONF / "init").glob("*.yaml"))


def test_own_init_leaves_the_weights_alone() -> None:
    network = LipschitzMlp(4, 16, 3)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    OwnInit()(network, None)
    torch.testing.assert_close(network.state_dict(), before, rtol=0, atol=0)


def test_source_init_is_the_source_at_every_time() -> None:
    field, source = ScalarSiren(4, 16, 3, omega=16.0), ScalarSiren(3, 16, 3, omega=32.0)
    SourceInit()(field, source)
    x = torch.rand(20, 3) * 2 - 1
    for t in (0.0, 0.3, 1.0):
        p = torch.cat([x, torch.full((20, 1), t)], 1)
        torch.testing.assert_close(field(p), source(x), rtol=1e-5, atol=1e-6)
        assert (field.jet(p).gradient[:, 3] == 0).all()


def test_official_init_is_the_source_read_at_a_lower_frequency() -> None:
    field, source = ScalarSiren(4, 16, 3, omega=30.0).double(), ScalarSiren(3, 16, 3, omega=60.0).double()
    OfficialInit(0.25)(field, source)
    slow = ScalarSiren(3, 16, 3, omega=15.0).double()
    slow.load_state_dict(source.state_dict())
    x = torch.rand(20, 3, dtype=torch.float64)
    torch.testing.assert_close(field(torch.cat([x, x[:, :1]], 1)), slow(x))


def test_siren_init_needs_no_source_and_changes_the_weights() -> None:
    field = ScalarSiren(4, 16, 3)
    before = field.linears[0].weight.clone()
    SirenInit()(field, None)
    assert not SirenInit.needs_source
    assert not torch.equal(field.linears[0].weight, before)


@pytest.mark.parametrize("init", [SourceInit(), OfficialInit()])
@pytest.mark.parametrize("source", [None, ScalarSiren(3, 8, 3), ScalarSiren(3, 16, 2)])
def test_f_starts_only_from_a_network_of_its_own_size(init: SourceInit, source: ScalarSiren | None) -> None:
    with pytest.raises(ValueError, match="same width and depth"):
        init(ScalarSiren(4, 16, 3), source)


@pytest.mark.parametrize("name", INITS)
def test_every_init_of_the_configuration_starts_f(name: str) -> None:
    init = instantiate(composed(f"init={name}").init)
    field = ScalarSiren(3, 8, 2)
    init(field, ScalarSiren(2, 8, 2) if init.needs_source else None)
    assert all(p.isfinite().all() for p in field.parameters())
