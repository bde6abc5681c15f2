"""`murmurate.` completes to what there is."""

from __future__ import annotations

import pkgutil
import types

import murmurate

INTERNAL = {
    "__main__",
    "compilation_cache",
    "forks",
    "interrupts",
    "prng",
    "representation",
    "terminal",
    "untrusted",
}


def test_every_public_name_and_module_is_there_and_listed():
    modules = {module.name for module in pkgutil.iter_modules(murmurate.__path__)} - INTERNAL
    assert modules <= set(dir(murmurate))
    for name in dir(murmurate):
        value = getattr(murmurate, name)
        if isinstance(value, types.ModuleType):
            assert value.__name__ == f"murmurate.{name}"
            modules.remove(name)
    assert modules == set()
