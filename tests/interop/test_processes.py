"""Environments in other processes, as copies, and as files: fork, spawn, pickle, deepcopy, flags, locale."""

from __future__ import annotations

import copy
import json
import multiprocessing
import os
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from by_hand import SWARM
from gymnasium.utils.env_checker import data_equivalence

from murmurate.errors import InputError
from murmurate.interop.gymnasium import ENV_ID
from murmurate.interop.pettingzoo import parallel_env

SCRIPT = Path(__file__).with_name("in_processes.py")

FLAGS = {"JAX_ENABLE_X64": "1", "JAX_DEFAULT_PRNG_IMPL": "rbg"}
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What one process found, with the flags and the locale of another user."""
    folder = tmp_path_factory.mktemp("processes")
    subprocess.run([sys.executable, SCRIPT, folder], env={**os.environ, **FLAGS, **ASCII}, check=True, timeout=120)
    (file,) = folder.iterdir()
    return json.loads(file.read_text(encoding="utf-8"))


forks = pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system cannot fork")


@forks
def test_nothing_starts_jax_before_the_first_reset_so_that_environments_can_be_forked(results):
    assert results["started"] is False
    assert len(results["fork"][1]) == 2


@forks
def test_workers_that_are_spawned_do_as_those_that_are_forked(results):
    assert results["spawn"] == results["fork"]


@forks
def test_workers_compute_as_this_process_does_whatever_flags_they_have(results):
    env = gymnasium.make(ENV_ID, **{name: value for name, value in SWARM.items() if name != "max_speed"})
    for seed, start, after in zip([4, 5], *results["fork"][1:], strict=True):
        np.testing.assert_array_equal(env.reset(seed=seed)[0], np.float32(start))
        np.testing.assert_allclose(env.step(np.ones((3, 2)))[0], after, rtol=1e-6)
    assert results["fork"][0] == "float32"


@forks
def test_a_process_forked_after_jax_was_started_is_refused_in_one_line(results):
    for message in (*results["too late"], results["computation"]):
        assert message.startswith("JAX had been started before this process was forked")
        assert 'context="spawn"' in message
        assert "\n" not in message


@forks
def test_an_error_of_a_worker_keeps_its_line(results):
    assert results["wrong action"] == ["action", "action = 'an array with NaN or infinity': must be finite"]


def test_pictures_do_not_depend_on_the_locale(results):
    assert results["picture"] == [400, 480, 3]


def test_errors_go_from_process_to_process():
    error = InputError("world.robots", 1, "an integer >= 2")
    for other in (pickle.loads(pickle.dumps(error)), copy.deepcopy(error), InputError(error)):
        assert str(other) == str(error) == "world.robots = 1: must be an integer >= 2"
        assert (other.field, other.value, other.allowed) == ("world.robots", 1, "an integer >= 2")


ENVIRONMENTS = {
    "one": lambda: gymnasium.make(ENV_ID, render_mode="rgb_array", **SWARM),
    "many": lambda: gymnasium.make_vec(ENV_ID, 2, "vector_entry_point", render_mode="rgb_array", **SWARM),
    "agents": lambda: parallel_env(render_mode="rgb_array", sensing={"use": "visible", "rotation": True}, **SWARM),
}


def actions_of(env, count):
    if hasattr(env, "possible_agents"):
        rng = np.random.default_rng(0)
        return [{name: rng.uniform(-1, 1, 2) for name in env.agents} for _ in range(count)]
    env.action_space.seed(0)
    return [env.action_space.sample() for _ in range(count)]


@pytest.mark.parametrize("kind", ENVIRONMENTS)
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_its_original_does_and_leaves_it_alone(kind, duplicate):
    env = ENVIRONMENTS[kind]()
    unbegun = duplicate(env)
    assert data_equivalence(unbegun.reset(seed=3), env.reset(seed=3), exact=True)
    actions = actions_of(env, 3)
    env.step(actions[0])
    env.render()
    twin = duplicate(env)
    for action in actions[1:]:
        assert data_equivalence(twin.step(action), env.step(action), exact=True)
    np.testing.assert_array_equal(twin.render(), env.render())
    twin.step(actions[0])
    assert not np.array_equal(twin.render(), env.render())
    assert data_equivalence(twin.reset(), env.reset(), exact=True)  # its randomness too
