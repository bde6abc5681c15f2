"""Times all signals of one large swarm, and fits how the time grows: `python -m benchmarks.large`.

Robots stand at random, each in its own cell of a grid 6 radii wide, without overlaps. The sizes take turns, and the
median of the rounds counts. Up to 256 robots the kernel that tests every triple of robots is timed too.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.measure import Case, measure
from murmurate.analysis.measures import fit_line
from murmurate.geometry._batch_last import visibility
from murmurate.world import UniformStart, World, WorldConfig

SIZES = (32, 64, 128, 256, 512, 1000, 1024)
DIRECT = (128, 256)
"""Sizes at which the direct kernel is timed too; its program grows with the swarm."""
FITTED = (128, 256, 512, 1024)
RADIUS = 1.0


def swarm(robots: int) -> tuple[jax.Array, float]:
    """Returns positions whose discs are apart, and the world's half side."""
    rng, across = np.random.default_rng(robots), math.ceil(math.sqrt(robots))
    half, side = 3 * math.sqrt(robots), 6 * math.sqrt(robots) / across
    cells = np.stack(np.divmod(rng.permutation(across**2)[:robots], across), axis=-1) * side
    return jnp.asarray(cells + rng.uniform(0, side - 2.01 * RADIUS, (robots, 2)) - half, jnp.float32), half


def all_signals(robots: int) -> Callable[[], Any]:
    positions, half = swarm(robots)
    sizes = {"half_width": half, "half_height": half, "scan_radius": 4 * half, "safe_distance": 5.0}
    world = World.create(WorldConfig(robots=robots, radius=RADIUS, **sizes), UniformStart(), "C2")
    program = jax.jit(lambda positions: world.signals(positions))
    return lambda: program(positions)


def directly(robots: int) -> Callable[[], Any]:
    positions, _ = swarm(robots)

    @jax.jit
    def program(positions: Any) -> Any:
        xp, positions = visibility.as_floating(positions)
        intervals = visibility.angular_intervals(xp, *visibility.offsets(xp, positions), RADIUS)
        return visibility.occluded_pairwise(xp, intervals)

    return lambda: program(positions)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15, help="timed rounds (default: 15)")
    options = parser.parse_args()
    cases = [Case("large", f"{n} robots, all signals", 1, functools.partial(all_signals, n), n, 1) for n in SIZES]
    cases += [
        Case("large", f"{n} robots, visibility, direct kernel", 1, functools.partial(directly, n), n, 1) for n in DIRECT
    ]
    timings, _ = measure(cases, options.repeats, lambda line: None)
    print("| one configuration | ms | ± | compiling, s |\n| --- | ---: | ---: | ---: |")
    for timing in timings:
        print(f"| {timing.case.name} | {timing.seconds * 1e3:.2f} | {timing.spread:.0%} | {timing.compile:.1f} |")
    seconds = dict(zip(SIZES, (timing.seconds for timing in timings), strict=False))
    line = fit_line([math.log(robots) for robots in FITTED], [math.log(seconds[robots]) for robots in FITTED])
    assert line is not None
    sizes = f"from {FITTED[0]} to {FITTED[-1]} robots"
    print(f"\nCost grows as N^{line.slope:.2f} {sizes}, by least squares of the logarithms.")


if __name__ == "__main__":
    main()
