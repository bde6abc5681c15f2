"""Names the machine and what is installed on it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any

import jax

__all__ = ["machine"]

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
    """Returns the bytes of memory that arrays may take: the accelerator's where there is one; 0 where nobody says."""
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
