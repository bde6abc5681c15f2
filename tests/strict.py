"""The type checker that every function of the package is decorated with in tests: see `conftest.py`."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

__all__ = ["check_types"]

check_types = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""As Python's typing has it: where a float is wanted, an int is as good."""
