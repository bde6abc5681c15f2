"""The type checker that decorates every function of the package in tests: see `conftest.py`."""

from __future__ import annotations

import functools
import inspect
import os
import sys
import typing
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import jax
import jaxtyping
import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype
from beartype.roar import BeartypeCallHintParamViolation
from jax import export
from jaxtyping import _import_hook

__all__ = ["CHECKED_CALLS", "begin_test", "check_types", "install"]

CHECKED_CALLS = 5 if os.environ.get("MURMURATE_TEST_COMPILER") == "full" else 1
"""Calls of one function in one test whose types are checked: a check takes longer than most functions take. The next
test's are checked anew, and the nightly tests check more of them."""

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


_jaxtyped = jaxtyping.jaxtyped

_calls: Counter[object] = Counter()
"""How often each function was called in this test."""


def begin_test():
    """Has every function's calls checked again."""
    _calls.clear()


def install(package):
    """Checks types and shapes in every function of a package that is imported after this.

    Functions that are given no arrays are checked by beartype alone: jaxtyping would take several times as long to note
    that there are no shapes to agree. Functions inside of functions are not checked at all, as they would be decorated
    anew at every call of the outer one.
    """
    jaxtyping.jaxtyped = _jaxtyped_where_there_are_shapes
    cached, folder = _import_hook._optimized_cache_from_source, Path(find_spec(package).origin).parent

    def of_the_package_alone(checker, path, *args, **kwargs):
        # A module that one of the package imports is not changed, and its bytecode is where it always is.
        is_ours = folder in Path(path).parents
        return cached(checker, path, *args, **kwargs) if is_ours else _import_hook.cache_from_source(path)

    _import_hook._optimized_cache_from_source = of_the_package_alone
    jaxtyping.install_import_hook(package, f"{__name__}.check_types")


def _jaxtyped_where_there_are_shapes(*, typechecker):
    def decorate(thing):
        if not inspect.isfunction(thing):
            return _jaxtyped(typechecker=typechecker)(thing)
        if "<locals>" in thing.__qualname__:
            return thing
        has_shapes = any('"' in str(hint) or "'" in str(hint) for hint in thing.__annotations__.values())
        return _sampled(thing, _jaxtyped(typechecker=typechecker) if has_shapes else typechecker)

    return decorate


def _sampled(function, checker):
    checked = functools.cache(lambda: checker(function))  # at the first call: many are never called

    @functools.wraps(function)
    def call(*args, **kwargs):
        _calls[function] += 1
        return (checked() if _calls[function] <= CHECKED_CALLS else function)(*args, **kwargs)

    return call


def check_types(function):
    """Checks types and shapes of what the package passes to its functions, and of what these return.

    What a test passes itself is not checked: many tests pass what is wrong, to see how the package refuses it.
    """

    @functools.cache  # at the first call: hints may name what is defined later
    def checked():
        try:
            typing.get_type_hints(function)
        except NameError:  # a hint names what is imported for type checkers only
            return function
        return beartype(conf=BeartypeConf(hint_overrides=FrozenDict(_NUMBERS)))(function)

    @functools.wraps(function)
    def check(*args, **kwargs):
        if jaxtyping.config.jaxtyping_disable:
            return function(*args, **kwargs)
        try:
            return checked()(*args, **kwargs)
        except BeartypeCallHintParamViolation:
            if _called_by_the_package():
                raise
        return function(*args, **kwargs)

    return check


def _called_by_the_package():
    frame = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _PASSED_THROUGH:
        frame = frame.f_back
    return frame is not None and frame.f_globals.get("__name__", "").startswith("murmurate")
