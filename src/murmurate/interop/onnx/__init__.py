"""Trained policies as ONNX models, for robots without JAX; the extra `onnx`.

`murmurate export RUN --onnx` does it from the command line.
"""

from murmurate.interop.onnx.models import CHECKED, TOLERANCE, Model, export

__all__ = ["CHECKED", "TOLERANCE", "Model", "export"]
