"""The compiler's count of operations, and the numbers, the page and the figure made of timings."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks import agreement, figure, machine, peers, report
from benchmarks.cases import SENSING, SIZED, STEP, TRAINING, scattered, sized
from benchmarks.measure import Case, Timing, compiler_cost

from murmurate.runs.table import as_markdown


@pytest.fixture(scope="module", autouse=True)
def usual_broadcasting():
    with jax.numpy_rank_promotion("allow"):
        yield


def test_the_compiler_counts_a_matrix_product_and_one_turn_of_a_loop():
    matrix = jnp.ones((64, 64))
    product = compiler_cost(lambda x: x @ x, matrix)
    assert (product["operations"], product["functions"]) == (2 * 64**3, 0)
    assert product["bytes"] == pytest.approx(2 * 4 * 64**2, rel=0.01)
    loop = compiler_cost(lambda x: jax.lax.fori_loop(0, 10, lambda _, x: x @ x, x), matrix)
    assert product["operations"] <= loop["operations"] < 1.1 * product["operations"]


def test_the_operations_of_a_step_grow_with_the_cube_of_the_swarm():
    costs = []
    for robots in (8, 32):
        world, positions = sized(robots), scattered(robots, 8)
        state = world.state(positions)
        costs.append(compiler_cost(lambda world, state, v: world.step(state, v), world, state, positions))
    assert 2.5 < np.log(costs[1]["operations"] / costs[0]["operations"]) / np.log(4) < 3.1


def timings():
    """Returns invented timings: the cost of a step grows as N^2, that of sensing as N^3."""

    def timing(part, name, work, seconds, robots=10, worlds=0, unit="steps"):
        return Timing(Case(part, name, work, lambda: lambda: None, robots, worlds, unit), 2 * seconds, (seconds,) * 3)

    names = (machine.PRODUCTS, machine.PLAIN, machine.VARIED, machine.ROOTS, machine.FUNCTIONS, machine.COPY)
    rows = [timing(machine.CEILING, name, 1e9, 1.0, unit="operations") for name in names]
    for robots in (4, 10, 32, 128, 256, 1024):
        rows.append(timing(SIZED, STEP, 256, 256e-8 * robots**2, robots, 256))
        rows.append(timing(SIZED, SENSING, 256, 256e-9 * robots**3, robots, 256))
    rows.append(timing(peers.PART, peers.JAXMARL, 256, 256e-5, 10, 256))
    return [*rows, timing(TRAINING, "central policy, an action every 2 steps", 1e6, 5.0, worlds=256)]


def counts(operations, functions, moved):
    return {"operations": operations, "functions": functions, "bytes": moved}


@pytest.fixture(scope="module")
def data():
    cases = report.records(timings())
    costs = [
        {"part": SIZED, "name": "a step", "robots": 10, "worlds": 256, **counts(2e4, 5e2, 1e3)},
        {"part": TRAINING, "name": "an update", "kind": "central", **counts(5e9, 1e8, 1e9)},
        {"part": TRAINING, "name": "not timed", "kind": "local", **counts(1e9, 1e8, 1e9)},
    ]
    about = {
        "processor": "P",
        "cores": 2,
        "memory_bytes": 2**34,
        "device": None,
        "system": "S",
        "versions": {"jax": "1"},
    }
    peaks = [{"part": SIZED, "name": STEP, "robots": 4, "worlds": 256, "peak_bytes": 2**20}]
    results = {"cases": cases, "costs": costs, "fits": report.fits(cases), "left_out": [], "memory": peaks}
    whole = {"machine": about, "repeats": 3, "updates": 2, "seconds": 60, **results}
    return json.loads(json.dumps(whole))


def test_exponents_are_those_of_the_timings(data):
    assert {(fit["name"], round(fit["exponent"], 2)) for fit in data["fits"]} == {(STEP, 2.0), (SENSING, 3.0)}


def test_the_page_names_the_machine_and_every_figure(data, tmp_path):
    text = report.markdown(data, "cost.png")
    for part in ("P, 2 cores, 16 GiB, S; jax 1.", "![", "1,000,000", "N = 128 to 1,024: 2.00", "| 1 MiB |"):
        assert part in text
    assert "| a step | 2e+04 | 500 | 1e+03 | 1 µs | 20.0 |" in text
    assert "| an update | 5e+09 | 1e+08 | 1e+09 | 2.5 s | 2.0 |" in text
    assert "not timed" not in text
    page = tmp_path / "page.md"
    page.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    report.write(page, text)
    assert page.read_text() == f"before\n{report.BEGIN}\n{text}{report.END}\nafter\n"


def test_the_figure_draws_every_size(data):
    left = figure.figure(data).axes[-2]
    drawn = np.concatenate([line.get_xdata() for line in left.lines])
    assert {4, 10, 32, 128, 256, 1024} <= set(drawn.astype(int))


def test_the_table_of_agreement_names_what_differs():
    seen = np.zeros(200_000, bool)
    two_differ = seen.copy()
    two_differ[:2] = True
    rows = [
        agreement._flags("who sees whom", 4, seen, two_differ),
        agreement._flags("who touches", 4, seen[:100], two_differ[:100]),
        agreement._numbers("signals", 4, {"safe": np.zeros(8)}, {"safe": np.full(8, 2e-4)}),
        agreement._curve("5 updates, central", np.array([1.0, 2.0]), np.array([1.0, 2.01])),
    ]
    assert [row[-1] for row in rows] == [True, False, False, True]
    table = as_markdown(("what", "N", "compared", "differ", "allowed", "agrees"), [row[:-1] for row in rows])
    assert "| who touches | 4 | 100 | 2 | 1e-05 of them | no |" in table
    assert "| 5 updates, central | 10 | 2 | by 5.0e-03 | 0.01 | yes |" in table
