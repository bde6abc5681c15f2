"""The type checker that decorates every function of the package in tests: see `conftest.py`."""

from __future__ import annotations

import functools
import sys

import jax
import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype
from beartype.roar import BeartypeCallHintViolation
from jax import export

__all__ = ["check_types"]

_Symbol = type(export.symbolic_shape("robots")[0])
"""A number of robots in a program for swarms of any size."""

_NUMBERS = {
    float: float | int | np.number | np.ndarray | jax.Array,
    int: int | np.integer | np.ndarray | jax.Array | _Symbol,
    bool: bool | np.bool_ | np.ndarray | jax.Array,
}
"""What a number is under a jit, or as NumPy computes it."""

_PASSED_THROUGH = ("beartype", "contextlib", "dataclasses", "equinox", "functools", "jax", "jaxtyping", __name__)
"""Modules between a function and what called it."""


def check_types(function):
    """Checks types and shapes of what the package passes to its functions, and of what these return.

    What a test passes itself is not checked: many tests pass what is wrong, to see how the package refuses it. Nor are
    functions inside of functions, which would be decorated anew at every call of the outer one.
    """
    if "<locals>" in function.__qualname__:
        return function
    checked = beartype(conf=BeartypeConf(hint_overrides=FrozenDict(_NUMBERS)))(function)

    @functools.wraps(function)
    def check(*args, **kwargs):
        try:
            return checked(*args, **kwargs)
        except BeartypeCallHintViolation:
            if _called_by_the_package():
                raise

    return check


def _called_by_the_package():
    frame = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _PASSED_THROUGH:
        frame = frame.f_back
    return frame is not None and frame.f_globals.get("__name__", "").startswith("murmurate")
