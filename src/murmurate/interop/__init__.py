"""Adapters to other tools: Gymnasium, PettingZoo, ONNX, TensorBoard, and waypoints for test beds.

This package imports none of them. Each module, such as `murmurate.interop.gymnasium`, imports the tool that it adapts
to, which is an optional extra.
"""

from __future__ import annotations

__all__ = ["missing_extra"]


def missing_extra(extra: str) -> ModuleNotFoundError:
    """Returns the error that names the command which installs an extra of this package."""
    return ModuleNotFoundError(f'murmurate.interop.{extra} needs {extra}: pip install "murmurate[{extra}]"', name=extra)
