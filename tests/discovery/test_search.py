"""Algorithm 2 with budgets so small that nothing is learned: what it does, not how well."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from handmade import Implode

from murmurate.discovery import DiscoveryConfig, Problem, RestRule, Search, StageConfig, policy_name, search
from murmurate.discovery.stage import draw_key, training_world
from murmurate.errors import InputError
from murmurate.geometry import clearances, neighbors
from murmurate.learning import GradientConfig, PPOConfig, ppo
from murmurate.policies import CentralPolicy
from murmurate.world import FileStart, ScatteredStart, SurroundedStart, WorldConfig, draw_starts

SIGMA, CHUNK, UPDATES = 12, 2, 4
PPO = PPOConfig(updates=UPDATES, worlds=8, steps=4, minibatches=2, epochs=1)
BASE = StageConfig(ppo=PPO, horizon=8)
AUXILIARY = StageConfig(
    ppo=replace(PPO, discount=0.9, policy_rate=5e-3, clip=0.1),
    horizon=6,
    noise=0.2,
    weights={"safety": 2.0, "neighbors": 2.0, "visible": 3.0},
)
PROBLEM = Problem(
    world=WorldConfig(robots=4, half_width=12.0, half_height=12.0, scan_radius=40.0, safe_distance=4.0, max_speed=0.5),
    objective="C2",
    start=ScatteredStart(),
    policy=CentralPolicy(hidden=(6,)),
    base=BASE,
    auxiliary=AUXILIARY,
    discovery=DiscoveryConfig(max_policies=3, sigma=SIGMA, episodes=SIGMA, chunk=CHUNK),
    rest=RestRule(max_steps=20),
    seed=0,
)


class Judged(Search):
    """A search that is told how good its patterns are."""

    share = 0.0

    def validity(self, policies, index):
        return self.share


@pytest.fixture
def handmade_policies(monkeypatch):
    """Has every cascade of a search do what a policy made by hand does."""

    def use(always):
        build = search.build_cascade

        def build_handmade(problem, policies, world=None):
            return build(problem, tuple(Implode(always) for _ in policies), world)

        monkeypatch.setattr(search, "build_cascade", build_handmade)

    return use


def finish(discovery, snapshot):
    while not snapshot.finished:
        snapshot, _ = discovery.advance(snapshot)
    return snapshot


def same(first, second):
    """Returns whether two trees are equal to the bit."""
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


@pytest.fixture(scope="module")
def unbroken():
    """Every snapshot of a discovery whose patterns are never valid, its metrics, and how often training was traced."""
    traced, update = [0], ppo._update

    def counted(*arguments):
        traced[0] += 1
        return update(*arguments)

    discovery = Judged(PROBLEM)
    snapshots, rows, counts = [discovery.begin()], [], []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ppo, "_update", counted)
        while not snapshots[-1].finished:
            snapshot, more = discovery.advance(snapshots[-1])
            snapshots.append(snapshot)
            rows += more
            counts.append(traced[0])
    return snapshots, rows, counts


def test_the_list_grows_to_its_end_while_nothing_is_valid(unbroken):
    snapshots, _, _ = unbroken
    assert [len(s.policies) for s in snapshots] == [0, 0, 1, 1, 2, 2, 3]
    assert [s.train is None for s in snapshots] == [True, False, True, False, True, False, True]
    assert [s.finished for s in snapshots] == [False] * 6 + [True]
    assert snapshots[-1].valid == 0
    assert [policy_name(i) for i in range(3)] == ["base", "auxiliary", "auxiliary"]
    for earlier, later in pairwise(snapshots):
        assert same(earlier.policies, later.policies[: len(earlier.policies)]), "a finished policy never changes"


def test_each_policy_is_another(unbroken):
    base, first, second = unbroken[0][-1].policies
    assert not same(base, first)
    assert not same(first, second)


def test_there_is_a_row_for_every_update(unbroken):
    _, rows, _ = unbroken
    assert [(r["policy"], r["update"]) for r in rows] == [(p, u) for p in range(3) for u in range(1, UPDATES + 1)]
    assert [r["name"] for r in rows] == ["base"] * UPDATES + ["auxiliary"] * 2 * UPDATES
    assert [r["policy_steps"] for r in rows[:UPDATES]] == [8 * 4 * u for u in range(1, UPDATES + 1)]
    for row in rows:
        assert set(row["signals"]) == {"nclose", "safety", "neighbors", "visible"}
        assert all(np.isfinite(v) for v in jax.tree.leaves(row) if not isinstance(v, str))


def test_base_and_auxiliary_share_one_compilation(unbroken):
    assert set(unbroken[2]) == {1}


def test_the_first_sigma_is_the_start_without_noise(unbroken):
    sigma = unbroken[0][0].sigma
    assert sigma.shape == (SIGMA, 4, 2)
    np.testing.assert_allclose(sigma, np.tile([[12, 0], [0, 12], [-12, 0], [0, -12]], (SIGMA, 1, 1)), atol=1e-5)


def test_every_sigma_is_free_of_collision_and_inside(unbroken):
    for snapshot in unbroken[0]:
        assert (clearances(np.asarray(snapshot.sigma), 1.0) > 0).all()
        assert (np.abs(snapshot.sigma) <= 12).all()


def test_the_auxiliary_is_trained_from_where_the_base_came_to_rest(unbroken):
    """Its episodes begin within its noise of a configuration of sigma*, on episodes' clocks of all ages."""
    between = unbroken[0][2]
    state = Judged(PROBLEM).training(between).env_state[0]
    offset = np.abs(np.moveaxis(np.asarray(state.positions), -1, 0)[:, None] - np.asarray(between.sigma))
    assert (offset.max(axis=(2, 3)).min(axis=1) <= 0.2 + 1e-5).all()
    assert offset.max(axis=(2, 3)).min(axis=1).max() > 0.05
    assert ((state.step >= 0) & (state.step < AUXILIARY.horizon)).all()
    assert len(np.unique(state.step)) > 1


def test_the_same_seed_makes_the_same_weights(unbroken):
    snapshots, _, _ = unbroken
    again = Judged(PROBLEM)
    assert same(finish(again, again.begin()).policies, snapshots[-1].policies)
    other = Judged(replace(PROBLEM, seed=1))
    assert not same(other.advance(other.begin())[0].train.policy, snapshots[1].train.policy)


@pytest.mark.parametrize("at", [1, 2, 3, 5])
def test_resuming_makes_the_same_weights(unbroken, at):
    """In the midst of a policy or between two; the snapshot has been to the host and back, the discovery is new."""
    snapshots, _, _ = unbroken
    host_copy = jax.device_get((snapshots[at].policies, snapshots[at].sigma, snapshots[at].train))
    policies, sigma, train = jax.tree.map(jnp.asarray, host_copy)
    ended = finish(Judged(PROBLEM), replace(snapshots[at], policies=policies, sigma=sigma, train=train))
    assert same(ended.policies, snapshots[-1].policies)
    assert same(ended.sigma, snapshots[-1].sigma)


def test_a_template_has_the_structure_of_what_it_is_for(unbroken):
    for at in (1, 3, 5):
        train = unbroken[0][at].train
        template = Judged(PROBLEM).training(unbroken[0][at])
        assert jax.tree.structure(template) == jax.tree.structure(train)
        for mine, its in zip(jax.tree.leaves(template), jax.tree.leaves(train), strict=True):
            assert (mine.shape, mine.dtype) == (its.shape, its.dtype)


def test_an_auxiliary_may_begin_with_the_weights_before(unbroken):
    warm = Judged(
        replace(PROBLEM, auxiliary=replace(AUXILIARY, warm_start=True, ppo=replace(AUXILIARY.ppo, log_std=-2.0)))
    )
    begun, before = warm.training(unbroken[0][2]).policy, unbroken[0][2].policies[-1]
    assert same((begun.body, begun.head), (before.body, before.head))
    np.testing.assert_array_equal(begun.log_std, -2.0)
    cold = Judged(PROBLEM).training(unbroken[0][2]).policy
    assert not same(cold.head, before.head)


REFINED = replace(
    PROBLEM,
    base=replace(BASE, refine=True, gradients=GradientConfig(updates=3, worlds=4, steps=2, minibatches=1, average=2)),
    discovery=replace(PROBLEM.discovery, max_policies=1, min_policies=1),
)


@pytest.fixture(scope="module")
def refined():
    """Every snapshot of a discovery whose base policy is refined, and its metrics."""
    discovery = Judged(REFINED)
    snapshots, rows = [discovery.begin()], []
    while not snapshots[-1].finished:
        snapshot, more = discovery.advance(snapshots[-1])
        snapshots.append(snapshot)
        rows += more
    return snapshots, rows


def test_gradients_refine_what_ppo_has_discovered(refined):
    """One policy in two phases: the second begins with the weights of the first and counts its own updates."""
    snapshots, rows = refined
    assert [s.phase for s in snapshots] == [0, 0, 1, 1, 0]
    assert [s.train is None for s in snapshots] == [True, False, True, False, True]
    assert [len(s.policies) for s in snapshots] == [0, 0, 0, 0, 1]
    begun = Judged(REFINED).training(snapshots[2])
    assert same(begun.policy, snapshots[2].unrefined)
    assert int(begun.update) == 0
    assert not same(snapshots[-1].policies[0], snapshots[2].unrefined)
    plain = Judged(replace(REFINED, base=replace(REFINED.base, refine=False)))
    assert same(finish(plain, plain.begin()).policies[0], snapshots[2].unrefined)
    ppo_steps = [8 * 4 * update for update in range(1, UPDATES + 1)]
    assert [(r["learner"], r["update"], r["policy_steps"]) for r in rows] == [
        *(("ppo", update, steps) for update, steps in enumerate(ppo_steps, 1)),
        *(("gradients", update, ppo_steps[-1] + 4 * 2 * update) for update in (1, 2, 3)),
    ]
    curriculum = Judged(REFINED).curriculum
    assert curriculum.policy_steps(0) == rows[-1]["policy_steps"]


@pytest.mark.parametrize("at", [1, 2, 3])
def test_resuming_a_refinement_makes_the_same_weights(refined, at):
    snapshots, _ = refined
    host_copy = jax.device_get((snapshots[at].unrefined, snapshots[at].sigma, snapshots[at].train))
    unrefined, sigma, train = jax.tree.map(jnp.asarray, host_copy)
    ended = finish(Judged(REFINED), replace(snapshots[at], unrefined=unrefined, sigma=sigma, train=train))
    assert same(ended.policies, snapshots[-1].policies)


def test_a_refinement_keeps_margins_and_costs_of_its_own():
    gradients = replace(REFINED.base.gradients, margins={"smooth_safety": 0.03})
    problem = replace(REFINED, base=replace(REFINED.base, gradients=gradients))
    signals, _ = problem.refinement(0)
    assert (signals["smooth_safety"].margin, signals["smooth_visible"].margin) == (0.03, 0.1)
    for name in ("compact", "visible", "nothing"):
        wrong = replace(REFINED.base, gradients=replace(gradients, margins={name: 0.03}))
        with pytest.raises(
            InputError, match=rf"base\.gradients\.margins\.{name} .*exposed, smooth_safety, smooth_visible"
        ):
            replace(REFINED, base=wrong).refinement(0)
    alone = StageConfig(learner="gradients", refine=True)
    assert (alone.learners, REFINED.base.learners) == (("gradients",), ("ppo", "gradients"))


@pytest.mark.parametrize(("least", "share", "policies"), [(1, 1.0, 1), (2, 1.0, 2), (1, 0.994, 3)])
def test_the_list_is_complete_when_patterns_are_valid(least, share, policies):
    discovery = Judged(replace(PROBLEM, discovery=replace(PROBLEM.discovery, min_policies=least)))
    discovery.share = share
    ended = finish(discovery, discovery.begin())
    assert len(ended.policies) == policies
    assert ended.valid == share


@pytest.mark.parametrize(("least", "shares", "policies"), [(1, (0.8, 0.5), 1), (1, (0.5, 0.8), 2), (2, (0.8, 0.5), 2)])
def test_a_last_policy_that_makes_patterns_worse_is_left_out(least, shares, policies):
    class Worse(Search):
        def validity(self, policies, index):
            return shares[index]

    numbers = replace(PROBLEM.discovery, min_policies=least, max_policies=2)
    discovery = Worse(replace(PROBLEM, discovery=numbers))
    ended = finish(discovery, discovery.begin())
    assert (len(ended.policies), ended.valid) == (policies, shares[policies - 1])
    assert ended.train is None


def test_nothing_follows_when_every_episode_ends_in_contact(handmade_policies):
    """Sigma is empty: the search ends without a valid pattern, and says so."""
    # From anywhere, a tight swarm may drift towards the origin without a change of its objective: that is rest.
    handmade_policies(True)
    discovery = Judged(replace(PROBLEM, base=replace(BASE, random_share=0.0)))
    ended = finish(discovery, discovery.begin())
    assert ended.finished
    assert len(ended.policies) == 1
    assert ended.sigma.shape == (0, 4, 2)
    assert ended.valid == 0


def test_sigma_holds_only_what_did_not_end_in_contact(handmade_policies):
    handmade_policies(False)
    discovery = Judged(PROBLEM)
    snapshot = discovery.begin()
    while not snapshot.policies:
        snapshot, _ = discovery.advance(snapshot)
    sigma = np.asarray(snapshot.sigma)
    assert sigma.shape == (SIGMA, 4, 2)
    assert (sigma[:, 1, 0] <= 0).all(), "these held still; all others collided"
    assert 1 < len(np.unique(sigma, axis=0)) < SIGMA, "repeated up to its size"
    assert (clearances(sigma, 1.0) > 0).all()


def test_validity_is_the_share_of_valid_episodes(handmade_policies):
    """Robots that hold still on their circle form a valid pattern if all are neighbours."""
    handmade_policies(None)
    discovery = Search(replace(PROBLEM, world=replace(PROBLEM.world, scan_radius=22.5)))
    starts = draw_starts(discovery.world.start, draw_key(PROBLEM, 1, "evaluation"), SIGMA, discovery.world.config)
    expected = neighbors(starts, 22.5).sum(axis=(1, 2)) == 4 * 3
    assert 0 < expected.mean() < 1
    assert discovery.validity((None,), 1) == expected.mean()


def crowd(tmp_path, **stage):
    """Four robots in a world with room for them in its corners only."""
    path = tmp_path / "starts.csv"
    path.write_text("start,x,y\n" + "".join(f"0,{x},{y}\n" for x in (-1.03, 1.03) for y in (-1.03, 1.03)))
    world = WorldConfig(robots=4, half_width=1.03, half_height=1.03, scan_radius=40.0, safe_distance=4.0)
    start = FileStart(file=str(path), noise=0.0)
    return replace(PROBLEM, world=world, start=start, base=replace(BASE, **stage))


def test_a_random_share_needs_room_for_random_starts(tmp_path):
    with pytest.raises(InputError, match="few enough to fit the random start"):
        Search(crowd(tmp_path, random_share=0.5))


def test_without_a_random_share_a_crowd_may_begin_as_it_is(tmp_path):
    """Random starts, of which none is needed, are not drawn at all."""
    discovery = Search(crowd(tmp_path, random_share=0.0))
    state = discovery.training(discovery.begin()).env_state[0]
    np.testing.assert_allclose(np.abs(state.positions), 1.03, rtol=1e-6)


def test_a_symmetric_share_begins_exactly_symmetric_and_only_the_base():
    problem = replace(PROBLEM, base=replace(BASE, symmetric_share=0.5))
    discovery = Search(problem)
    snapshot = discovery.begin()
    counts = []
    for index in range(2):
        world = training_world(problem, index, discovery.world.start, snapshot.sigma)
        positions = draw_starts(world.start, jax.random.key(1), 400, world.config)
        # Turned by half a turn around the origin, each of these families is what it was.
        turned = np.abs(positions[:, :, None] + positions[:, None]).max(axis=-1).min(axis=2).max(axis=1)
        counts.append(int((turned < 1e-4).sum()))
    assert 160 < counts[0] < 240
    assert counts[1] == 0


def test_a_hard_share_begins_crowded_or_at_walls_and_only_the_base():
    problem = replace(PROBLEM, base=replace(BASE, hard_share=0.5, random_share=0.0))
    discovery = Search(problem)
    snapshot = discovery.begin()
    base, auxiliary = (training_world(problem, index, discovery.world.start, snapshot.sigma) for index in range(2))
    points = draw_starts(base.start, jax.random.key(1), 400, base.config)
    assert (np.abs(points) <= base.config.bounds).all()
    # Only lines along walls, of the start `hard`, have all robots at exactly one distance from a wall.
    assert int((np.ptp(points, axis=1) == 0).any(axis=1).sum()) == pytest.approx(400 * 0.5 / 7, abs=20)
    assert auxiliary.start.share == 0


def test_a_surrounded_share_begins_in_rings_and_only_the_base():
    problem = replace(PROBLEM, base=replace(BASE, surrounded_share=0.5, random_share=0.0))
    search = Search(problem)
    snapshot = search.begin()
    base, auxiliary = (training_world(problem, index, search.world.start, snapshot.sigma) for index in range(2))
    assert isinstance(base.start.second, SurroundedStart)
    assert (float(base.start.share), auxiliary.start.share) == (0.5, 0)


def test_a_policy_may_be_rewarded_for_a_smooth_signal_beside_its_objective():
    """The signal is in the reward of that policy alone, not in what the list is judged by or what is recorded."""
    problem = replace(PROBLEM, base=replace(BASE, weights={**BASE.weights, "convex": 2.0}))
    search = Search(problem)
    base, auxiliary = (training_world(problem, index, search.world.start, search.begin().sigma) for index in range(2))
    assert float(base.objective.weights["convex"]) == 2.0
    assert base.objective.names == (*problem.signal_names, "convex")
    assert auxiliary.objective.names == search.world.objective.names == problem.signal_names
    around = 6.0 * np.stack([np.cos(turns := np.arange(3) * 2 * np.pi / 3), np.sin(turns)], axis=1)
    inside, outside = (np.concatenate([around, [[0.0, y]]]).astype(np.float32) for y in (0.0, 12.0))
    inner, outer = (
        float(base.objective(base.signals(points)) - search.world.objective(search.world.signals(points)))
        for points in (inside, outside)
    )
    assert outer == pytest.approx(2.0, abs=1e-5)
    assert inner < 1.9


def test_a_hard_share_needs_room_for_hard_starts(tmp_path):
    with pytest.raises(InputError, match="few enough to fit the cluster start"):
        Search(crowd(tmp_path, random_share=0.0, hard_share=0.5))


@pytest.mark.parametrize(
    "fields",
    [
        {"horizon": 0},
        {"noise": -1.0},
        {"noise": float("inf")},
        {"random_share": 1.5},
        {"random_spread": 0.0},
        {"symmetric_share": -0.1},
        {"hard_share": 1.1},
        {"surrounded_share": -1.0},
    ],
)
def test_no_such_stage(fields):
    with pytest.raises(InputError, match=f"^{next(iter(fields))} = "):
        StageConfig(**fields)


@pytest.mark.parametrize(
    "fields",
    [{"max_policies": 1}, {"min_policies": 0}, {"required_valid": 1.1}, {"sigma": 0}, {"episodes": 0}, {"chunk": 0}],
)
def test_no_such_discovery(fields):
    with pytest.raises(InputError, match=f"^{next(iter(fields))} = "):
        DiscoveryConfig(**fields)
