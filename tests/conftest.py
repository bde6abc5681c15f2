"""What every test shares: strict types and numerics, compiled programs, tiny runs, the same hypothesis examples."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import itertools
import os
import shutil
import sys
from pathlib import Path

# Before JAX is loaded: one cache of compiled programs for all tests and the processes that they start.
ROOT = Path(__file__).parents[1]
os.environ.setdefault("MURMURATE_CACHE", str(ROOT / ".cache"))

# Modules are compiled once for all workers and the processes that they start, whatever the environment says.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Two workers with a thread for every core each would wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if os.environ.get("MURMURATE_TEST_COMPILER") != "full":
    # What a test runs once takes longer to compile than to run: it is not optimised, here and in the processes that
    # tests start, but for `make test-nightly`.
    simplifications = (
        "batch-dot-simplification",
        "convolution-group-converter",
        "gather_simplifier",
        "reshape-mover",
        "simplify-conditional",
        "simplify-sorts",
        "simplify-while-loops",
        "tree_reduction_rewriter",
        "while-loop-constant-sinking",
        "while-loop-invariant-code-motion",
    )
    flags = (
        "--xla_backend_optimization_level=0",
        "--xla_cpu_use_fusion_emitters=false",
        "--xla_cpu_parallel_codegen_split_count=1",
        f"--xla_disable_hlo_passes={','.join(simplifications)}",
    )
    os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *flags])

# Tracing programs makes many objects that stay, among which the collector would look for garbage again and again.
gc.set_threshold(200_000, 20, 50)

# No test cuts the power, after which alone it matters what has reached the disk.
os.fsync = lambda descriptor: None

import filelock
import hypothesis
import jax
import jaxtyping
import pytest

import strict

# Before the package is loaded: every call of one of its functions checks types and shapes.
strict.install("murmurate")

from tiny import KINDS, tiny

hypothesis.settings.register_profile("ci", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("ci")

BATCH_LAST = {"cli", "discovery", "docs", "interop", "learning", "own", "policies", "report", "runs", "world"}
"""Folders in which arrays may gain axes: the world and what executes it has the batch last, and one flag an episode
meets `(robots, 2, batch)` on purpose. Everywhere else an array that gains axes is an error."""

STRICT_TYPES = {"geometry"}
"""Folders in which no array may change its type by accident either; optax needs the usual rules."""

FIRST = (
    "test_own_parts.py",
    "test_onnx.py",
    "test_docs_blocks.py",
    "test_weights.py",
    "test_verbs.py",
    "test_sensing_run.py",
    "test_own_strategies.py",
    "test_sizes.py",
    "test_training.py",
    "test_many.py",
    "test_comparison.py",
    "test_visibility_sweep.py",
    "test_search.py",
    "test_hard_starts.py",
    "test_tiles.py",
)
"""The files that take longest: they begin first, so that no worker is left alone with one of them at the end."""


def pytest_collection_modifyitems(items):
    """Puts the files that take longest first; a worker takes whole files, which share fixtures and programs."""
    items.sort(key=lambda item: FIRST.index(item.path.name) if item.path.name in FIRST else len(FIRST))


@pytest.fixture(scope="module", autouse=True)
def numerics(request):
    """Sets how strict JAX is, anew for every file, so that no file changes it for another one."""
    (folder, *_) = request.path.relative_to(ROOT / "tests").parts
    with (
        jax.numpy_rank_promotion("allow" if folder in BATCH_LAST else "raise"),
        jax.numpy_dtype_promotion("strict" if folder in STRICT_TYPES else "standard"),
    ):
        yield


@pytest.fixture(scope="module", autouse=True)
def small_pictures(request):
    """Writes figures in few pixels, and animations of few frames, where what they show is not the question."""
    shown = {"plots", "report", "test_docs_figures.py"} & {request.path.parent.name, request.path.name}
    with contextlib.nullcontext() if shown else few_pixels():
        yield


@contextlib.contextmanager
def few_pixels():
    """Writes figures in few pixels, and animations of few frames."""
    from murmurate.plots import animation, style

    png, times = style.png, animation._times
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "png", lambda figure, dpi: png(figure, min(dpi, 40)))
        patch.setattr(animation, "_times", lambda steps, fps: times(steps, 1))
        yield


@pytest.fixture(autouse=True)
def unchecked(request):
    """Checks types anew, but for tests whose wrong values the package passes on before it refuses them."""
    strict.begin_test()
    if request.node.get_closest_marker("unchecked") is None:
        yield
        return
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="module", autouse=True)
def _small_process():
    """Forgets compiled programs after a file, once they take much of the machine: they can be read from the cache."""
    yield
    if _takes_much():
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(AttributeError, OSError):  # a C library other than glibc
            ctypes.CDLL(None).malloc_trim(0)  # glibc keeps freed memory for itself


MAX_MEMORY_MAPS = 65530
"""Linux's usual limit for a process, /proc/sys/vm/max_map_count: every compiled program takes some."""


def _takes_much():
    """Returns whether this process takes a quarter of the machine's memory: there are two, which start others."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        maps = Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:  # not Linux
        return False
    return pages > os.sysconf("SC_PHYS_PAGES") / 4 or maps > 0.7 * MAX_MEMORY_MAPS


@pytest.fixture(scope="session")
def quick_conversion():
    """Makes models in half the time: jax2onnx seeks what made each value among all nodes, beginning with the first."""
    from jax2onnx.converter import output_binding

    from_the_first = output_binding._value_is_graph_connected

    def connected(context, value):
        last = itertools.islice(reversed(context.builder.nodes), 32)
        return any(output is value for node in last for output in node.outputs) or from_the_first(context, value)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output_binding, "_value_is_graph_connected", connected)
        yield


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory):
    """Returns the folder of a finished tiny run of a kind, which the first test of all workers that needs it trains.

    Nobody changes it: see `copy_of_tiny_run`.
    """
    base = tmp_path_factory.getbasetemp()
    # The workers of pytest-xdist have a folder each, side by side in one of the session.
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "tiny-runs"
    root.mkdir(exist_ok=True)

    @functools.cache
    def run(kind="central"):
        from murmurate.cli.main import main
        from murmurate.runs import config_io

        folder = root / kind
        with filelock.FileLock(root / f"{kind}.lock"):
            if not folder.exists():
                toml = root / f"{kind}.toml"
                toml.write_text(config_io.dump_toml(tiny(**KINDS[kind])), encoding="utf-8")
                with few_pixels(), jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
                    assert main(["discover", str(toml), "--out", str(folder), "--quiet"]) == 0
        return folder

    return run


@pytest.fixture
def copy_of_tiny_run(tiny_run, tmp_path):
    """Returns a copy of a tiny run that a test may change."""
    return lambda kind="central": shutil.copytree(tiny_run(kind), tmp_path / "run")
