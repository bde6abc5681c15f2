"""The machine: its name, what is installed on it, and its ceilings, each kind of work alone on data that suits it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.measure import Case

__all__ = ["CEILING", "Extent", "ceiling_cases", "machine", "memory_bytes"]

PACKAGES = ("murmurate", "jax", "jaxlib", "numpy", "equinox")
PEERS = ("jaxmarl", "vmas", "stable-baselines3", "torch")


def machine() -> dict[str, Any]:
    """Returns processor, usable cores, memory, accelerator, system and versions."""
    device = jax.devices()[0]
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_bytes": memory_bytes(),
        "device": None if device.platform == "cpu" else device.device_kind,
        "system": platform.system(),
        "versions": {"Python": platform.python_version(), **{name: _version(name) for name in (*PACKAGES, *PEERS)}},
    }


def memory_bytes() -> int:
    """Returns the bytes of memory for arrays: those of the accelerator if there is one; 0 if unknown."""
    stats = jax.devices()[0].memory_stats() or {}
    if "bytes_limit" in stats:
        return stats["bytes_limit"]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return 0


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


CEILING = "ceiling"
PRODUCTS = "matrix product"
PLAIN = "multiply and add"
VARIED = "compare, multiply, add, choose"
ROOTS = "square root"
FUNCTIONS = "hyperbolic tangent"
COPY = "copy"

DEPTH = 16
"""Operations of a chain before its array is stored again: enough for arithmetic, not memory, to set the pace."""


@dataclass(frozen=True)
class Extent:
    """Sizes of the ceilings' arrays.

    Attributes:
        side: Side of the square matrices.
        copied: Length of the array that is copied.
        chained: Length of the arrays of the chains: short enough for the processor's caches.
        links: Length of each chain.
    """

    side: int = 2048
    copied: int = 1 << 25
    chained: int = 1 << 16
    links: int = 1 << 10


def ceiling_cases(extent: Extent) -> list[Case]:
    """Returns the six cases: operations per second of five kinds, and bytes per second."""
    turns = max(extent.links // DEPTH, 1)
    chains = {
        PLAIN: (lambda x, p, q: x * p + q, 2, 8),
        VARIED: (lambda x, p, q: jnp.where(x > p, x * p, x + q), 4, 2),
        ROOTS: (lambda x, p, q: jnp.sqrt(x), 1, 1),
        FUNCTIONS: (lambda x, p, q: jnp.tanh(x), 1, 1 / 8),
    }
    cases = [_product(extent.side), _copy(extent.copied)]
    for name, (link, operations, often) in chains.items():
        cases.append(_chain(name, link, operations, extent.chained, max(round(often * turns), 1)))
    return cases


def _product(side: int) -> Case:
    def prepare() -> Callable[[], Any]:
        matrix = jax.random.normal(jax.random.key(0), (side, side))
        run = jax.jit(lambda a: a @ a)
        return lambda: run(matrix)

    return Case(CEILING, PRODUCTS, 2 * side**3, prepare, unit="operations")


def _copy(numbers: int) -> Case:
    """Reads, changes and writes every number of one array; a new array would cost page faults, not bandwidth."""

    def prepare() -> Callable[[], Any]:
        @jax.jit
        def run(factor: Any) -> Any:
            return jax.lax.fori_loop(0, COPIES, lambda _, x: x * factor, jnp.broadcast_to(factor, (numbers,)))[0]

        return lambda: run(jnp.float32(0.999))

    return Case(CEILING, COPY, COPIES * 2 * 4 * numbers, prepare, unit="bytes")


COPIES = 8


def _chain(name: str, link: Callable[[Any, Any, Any], Any], operations: int, numbers: int, turns: int) -> Case:
    """Repeats a few operations on each number of an array."""

    def prepare() -> Callable[[], Any]:
        @jax.jit
        def run(x: Any, p: Any, q: Any) -> Any:
            def turn(_: Any, x: Any) -> Any:
                for _ in range(DEPTH):
                    x = link(x, p, q)
                return x

            return jax.lax.fori_loop(0, turns, turn, x)

        # Every chain converges to a value between 0 and 1, so nothing overflows.
        return lambda: run(jnp.linspace(0.5, 1.0, numbers), jnp.float32(0.5), jnp.float32(0.25))

    return Case(CEILING, name, operations * DEPTH * turns * numbers, prepare, unit="operations")
