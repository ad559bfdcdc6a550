"""The checker that `conftest.py` lays over every function of the package."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

#: An int passes for a float, as PEP 484 says: a configuration writes ``omega: 30``.
check = beartype(conf=BeartypeConf(is_pep484_tower=True))
