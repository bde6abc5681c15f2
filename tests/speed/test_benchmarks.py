"""Hand counts beside the compiler's own, and what is made of timings."""

from __future__ import annotations

import json

import equinox as eqx
import jax
import numpy as np
import pytest
from benchmarks import ceilings, counts, figure, peers, report, summary
from benchmarks.cases import EXPERIMENT, SENSING, SIZED, STEP, TRAINING, Size, scattered, sized
from benchmarks.timing import Case, Timing

from murmurate.discovery import Discovery
from murmurate.runs import presets


@pytest.fixture(scope="module", autouse=True)
def usual_broadcasting():
    with jax.numpy_rank_promotion("allow"):
        yield


def compiled(program, *arguments):
    """Operations that the compiler counts, those on tangents and the like apart."""
    found = eqx.filter_jit(program).lower(*arguments).compile().compiled.cost_analysis()
    return found["flops"], found.get("transcendentals", 0.0)


@pytest.mark.parametrize("kind", ["central", "equivariant"])
def test_a_forward_pass_is_counted_as_the_compiler_counts_it(kind):
    config = presets.resolve(EXPERIMENT, {"policy": {"kind": kind}})
    worlds = 8
    networks = Discovery(config).networks(0)
    for network, (forward, _) in zip(networks, counts.networks(config.policy, config.world.robots), strict=True):
        flops, functions = compiled(lambda net, x: net(x), network, scattered(config.world.robots, worlds))
        assert 0.6 < worlds * (forward.operations - forward.functions) / flops < 1.5
        assert 0.4 < worlds * (forward.functions + forward.roots) / functions < 2.5


@pytest.mark.parametrize("robots", [4, 10, 32])
def test_a_step_is_counted_as_the_compiler_counts_it(robots):
    worlds = 8
    world, positions = sized(robots), scattered(robots, worlds)
    flops, _ = compiled(lambda world, state, v: world.step(state, v), world, world.state(positions), positions)
    assert 0.5 < worlds * counts.step(robots).operations / flops < 2


def test_a_floor_is_what_operations_or_bytes_take_whichever_is_more():
    rates = counts.Rates(products=10, plain=5, roots=1, functions=1, bytes=100)
    assert counts.floor(counts.Work(products=20, plain=5), rates) == (3, "operations")
    assert counts.floor(counts.Work(plain=5, bytes=1000), rates) == (10, "bytes")
    assert 2 * counts.Work(plain=1) + counts.Work(roots=3) == counts.Work(plain=2, roots=3)


def timings():
    """Made-up ones: the cost of a step grows as N^2, that of sensing as N^3."""

    def timing(part, name, work, seconds, robots=10, worlds=0, unit="steps"):
        return Timing(Case(part, name, work, lambda: lambda: None, robots, worlds, unit), 2 * seconds, (seconds,) * 3)

    names = (ceilings.PRODUCTS, ceilings.PLAIN, ceilings.VARIED, ceilings.ROOTS, ceilings.FUNCTIONS, ceilings.COPY)
    found = [timing(ceilings.PART, name, 1e9, 1.0, unit="operations") for name in names]
    for robots in (4, 10, 32, 128, 256, 1024):
        found.append(timing(SIZED, STEP, 256, 256e-8 * robots**2, robots, 256))
        found.append(timing(SIZED, SENSING, 256, 256e-9 * robots**3, robots, 256))
    found.append(timing(peers.PART, peers.JAXMARL, 256, 256e-5, 10, 256))
    return [*found, timing(TRAINING, "central policy, an action every 2 steps", 1e6, 5.0, worlds=256)]


@pytest.fixture(scope="module")
def data():
    found = summary.summary(timings(), [], Size())
    about = {
        "processor": "P",
        "cores": 2,
        "memory_bytes": 2**34,
        "device": None,
        "system": "S",
        "versions": {"jax": "1"},
    }
    peaks = [{"part": SIZED, "name": STEP, "robots": 4, "worlds": 256, "peak_bytes": 2**20}]
    whole = {"machine": about, "repeats": 3, "updates": 2, "seconds": 60, **found, "memory": peaks}
    return json.loads(json.dumps(whole))


def test_exponents_are_those_of_the_timings(data):
    assert {(fit["name"], round(fit["exponent"], 2)) for fit in data["fits"]} == {(STEP, 2.0), (SENSING, 3.0)}


def test_an_aim_is_met_or_it_is_not(data):
    met = {aim["what"]: aim["met"] for aim in data["aims"]}
    assert met["world steps/s, ten robots"]  # 1e8 / 10^2
    assert met["times JaxMARL's steps/s, 256 worlds"]  # 10 times
    assert met["training steps/s, central"]  # 200,000
    assert met["seconds of a step of 1,024 robots"] is False  # 256 worlds at once take 2.7 s
    assert met["exponent of the cost of a step, 128 to 1,024 robots"]
    slow = {**data, "cases": [{**row, "per_second": 1.0} for row in data["cases"]]}
    assert not any(aim["met"] for aim in summary.aims(slow) if "training" in aim["what"] and aim["above_floor"] > 2)


def test_the_page_names_the_machine_and_every_figure(data, tmp_path):
    text = report.markdown(data, "cost.png")
    for part in ("P, 2 cores, 16 GiB, S; jax 1.", "![", "1,000,000", "N = 128 to 1,024: 2.00", "yes", "no |", "1 MiB"):
        assert part in text
    page = tmp_path / "page.md"
    page.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    report.write(page, text)
    assert page.read_text() == f"before\n{report.BEGIN}\n{text}{report.END}\nafter\n"


def test_the_figure_draws_every_size(data):
    left = figure.figure(data).axes[-2]
    drawn = np.concatenate([line.get_xdata() for line in left.lines])
    assert {4, 10, 32, 128, 256, 1024} <= set(drawn.astype(int))
