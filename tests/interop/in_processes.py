"""What `test_processes.py` runs in a process of its own, which begins without JAX: prints what it found as JSON."""

from __future__ import annotations

import json
import multiprocessing
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
from jax._src import xla_bridge
from jax.extend import backend  # loads JAX, and starts nothing

from murmurate import prng
from murmurate.errors import ForkError, InputError
from murmurate.interop.gymnasium import ENV_ID
from murmurate.interop.pettingzoo import parallel_env
from murmurate.world import UniformStart, WorldConfig, draw_starts

SWARM = {"robots": 3, "half_width": 12.0, "half_height": 10.0, "scan_radius": 9.0, "safe_distance": 4.0}


def workers(context, **options):
    return gymnasium.make_vec(
        ENV_ID, num_envs=2, vectorization_mode="async", vector_kwargs={"context": context}, **SWARM | options
    )


def first(env):
    """The first observations of two workers, and those after a step."""
    start, _ = env.reset(seed=[4, 5])
    after = env.step(np.ones((2, 3, 2), np.float32))[0]
    env.close()
    return [start.dtype.name, start.tolist(), after.tolist()]


def refusal(env):
    try:
        env.reset(seed=0)
    except ForkError as error:
        return str(error)
    finally:
        env.close(terminate=True)


def wrong_action(env):
    env.reset(seed=0)
    try:
        env.step(np.full((2, 3, 2), np.nan))
    except InputError as error:
        return [error.field, str(error)]
    finally:
        env.close(terminate=True)


def compute(queue, *start):
    try:
        draw_starts(*start)
    except ForkError as error:
        queue.put(str(error))


def main(folder):
    result = {}
    parallel_env(**SWARM)
    gymnasium.make_vec(ENV_ID, num_envs=2, vectorization_mode="vector_entry_point", **SWARM)
    result["fork"] = first(workers("fork"))
    result["wrong action"] = wrong_action(workers("fork"))
    result["started"] = xla_bridge.backends_are_initialized()
    result["spawn"] = first(workers("spawn"))
    backend.backends()
    result["too late"] = [refusal(workers("fork")), refusal(workers("fork", start="scattered"))]
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    process = context.Process(target=compute, args=(queue, UniformStart(), prng.key(0), 1, WorldConfig()))
    process.start()
    result["computation"] = queue.get(timeout=60)
    process.join()
    env = gymnasium.make(ENV_ID, render_mode="rgb_array", **SWARM)
    env.reset(seed=4)
    result["picture"] = env.render().shape
    Path(folder, "found.json").write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # JAX warns of every fork
    gymnasium.logger.min_level = 50
    main(sys.argv[1])
