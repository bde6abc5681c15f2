"""Whether an accelerator computes what the CPU does: `python -m benchmarks.agreement`.

The same programs run on both, from the same numbers: who sees whom and who touches, all signals, and the first updates
of training. Sums are taken in another order and products rounded once instead of twice, so what rounding decides may
differ: one answer in 100,000, signals by 1e-4, a learning curve by a hundredth of its greatest value. Exit status 1 if
more does.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from benchmarks.cases import Size, chunk, scattered, sized
from murmurate.geometry import _batch_last
from murmurate.learning import train_chunk
from murmurate.runs.table import as_markdown

SWARMS = ((4, 4096), (10, 4096), (32, 512), (64, 128), (128, 16), (256, 4))
"""Swarm sizes, and how many swarms of each."""

UPDATES = 5
FLAGS, NUMBERS, CURVES = 1e-5, 1e-4, 1e-2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", default="gpu", help="what to compare the CPU with (default: gpu)")
    parser.add_argument("--curve", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.curve:
        print(json.dumps(_learned(options.curve).tolist()))
        return
    try:
        device = jax.devices(options.platform)[0]
    except RuntimeError as error:
        parser.error(f"--platform {options.platform}: JAX finds none here: {error}")
    rows = list(_rows(device))
    print(f"{device.device_kind} beside the CPU; jax {jax.__version__}\n")
    print(as_markdown(("what", "N", "compared", "differ", "allowed", "agrees"), [row[:-1] for row in rows]), end="")
    sys.exit(not all(row[-1] for row in rows))


def _rows(device: jax.Device) -> Iterator[tuple[Any, ...]]:
    for robots, worlds in SWARMS:
        world, positions = sized(robots), np.asarray(scattered(robots, worlds))
        rng = np.random.default_rng(robots)
        # Some close together, discs over one another among them, some far apart.
        positions = (positions * rng.uniform(0.3, 1.0, (1, 1, worlds))).astype(np.float32)
        velocities = rng.uniform(-1, 1, positions.shape).astype(np.float32)
        radius, far = float(world.config.radius), float(world.config.scan_radius)
        visible_pairs = _both(device, lambda x, r=radius, far=far: _batch_last.visible(x, r, far), positions)
        yield _flags("who sees whom", robots, *visible_pairs)
        contacts = _both(device, lambda x, v, r=radius: _batch_last.in_contact(x, v, r), positions, velocities)
        yield _flags("who touches", robots, *contacts)
        yield _numbers("signals", robots, *_both(device, lambda world, x: world.signals(x), world, positions))
    for kind in ("equivariant", "central"):
        yield _curve(f"{UPDATES} updates, {kind}", _elsewhere(kind), _learned(kind))


def _both(device: jax.Device, program: Callable[..., Any], *arguments: Any) -> tuple[Any, Any]:
    """Runs a program on the CPU and on a device."""
    results = []
    for target in (jax.devices("cpu")[0], device):
        with jax.default_device(target):
            results.append(jax.device_get(jax.jit(program)(*jax.device_put(arguments, target))))
    return results[0], results[1]


def _learned(kind: str) -> np.ndarray:
    """Returns the learning curve of the first updates of a policy, on the devices of this process."""
    training = chunk(kind, Size(updates=UPDATES))
    return np.asarray(train_chunk(training.state, training.env, training.hyper, training.shape, UPDATES)[1]["reward"])


def _elsewhere(kind: str) -> np.ndarray:
    """Returns the same of a process that has the CPU alone."""
    command = [sys.executable, "-m", "benchmarks.agreement", "--curve", kind]
    process = subprocess.run(command, env=os.environ | {"JAX_PLATFORMS": "cpu"}, capture_output=True, check=True)
    return np.asarray(json.loads(process.stdout))


def _flags(label: str, robots: int, on_cpu: Any, on_device: Any) -> tuple[Any, ...]:
    different = int((on_cpu != on_device).sum())
    agrees = different <= max(1, FLAGS * on_cpu.size)
    return (
        label,
        str(robots),
        f"{on_cpu.size:,}",
        f"{different:,}",
        f"{FLAGS:g} of them",
        "yes" if agrees else "no",
        agrees,
    )


def _numbers(label: str, robots: int, on_cpu: Any, on_device: Any) -> tuple[Any, ...]:
    difference = max(float(np.abs(on_cpu[name] - on_device[name]).max()) for name in on_cpu)
    size = sum(value.size for value in on_cpu.values())
    return (
        label,
        str(robots),
        f"{size:,}",
        f"by {difference:.1e}",
        f"{NUMBERS:g}",
        "yes" if difference <= NUMBERS else "no",
        difference <= NUMBERS,
    )


def _curve(label: str, on_cpu: Any, on_device: Any) -> tuple[Any, ...]:
    difference = float(np.abs(on_cpu - on_device).max() / np.abs(on_cpu).max())
    return (
        label,
        "10",
        f"{on_cpu.size:,}",
        f"by {difference:.1e}",
        f"{CURVES:g}",
        "yes" if difference <= CURVES else "no",
        difference <= CURVES,
    )


if __name__ == "__main__":
    main()
