"""Where episodes begin: every kind of start, drawn, never in collision, always inside."""

from __future__ import annotations

import signal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.geometry._batch_last import clearances, distances
from murmurate.world import (
    DistributedStart,
    FileStart,
    JitteredStart,
    MixtureStart,
    PackedStart,
    ScatteredStart,
    Start,
    SymmetricStart,
    UniformStart,
    WorldConfig,
    check_start,
    draw_starts,
    episodes_at_once,
    read_named_starts,
    read_starts,
    redraw_overlaps,
    scaled_to,
    starts,
)
from murmurate.world.symmetric_starts import symmetric_layout

LAYOUTS = ("scattered", "distributed", "packed")
BATCH = 32
UNIT = WorldConfig(robots=2, half_width=50.0, half_height=50.0)


def start_of(use="scattered", **fields):
    return Start.registered()[use](**fields)


def draw(start, key, batch, world):
    """Draws a batch, batch last as the kernels below take it."""
    return np.moveaxis(draw_starts(start, key, batch, world), 0, -1)


def roomy(robots, **sizes):
    """A world in which every layout of that many robots fits."""
    return WorldConfig(robots=robots, **{"half_width": 130.0, "half_height": 100.0, **sizes})


def layout(start, world):
    """The one configuration that a start jitters."""
    return start.layouts(world)[0]


def assert_clean(positions, world):
    """None in collision, none outside: in the precision that a run computes with."""
    assert np.isfinite(positions).all()
    assert (clearances(positions, np.float32(world.radius)) > 0).all()
    bounds = np.array([world.half_width, world.half_height], np.float32)
    assert (np.abs(positions) <= bounds[:, None]).all()


@pytest.mark.parametrize("kind", LAYOUTS)
def test_layouts_of_any_number_of_robots(kind):
    for robots in range(2, 41):
        world = roomy(robots)
        for lines in (1, 2, 3) if kind == "packed" else (1,):
            points = layout(start_of(kind, **({"lines": lines} if kind == "packed" else {})), world)
            assert points.shape == (robots, 2)
            assert_clean(points[:, :, None], world)


@pytest.mark.parametrize("robots", [2, 13, 40])
@given(
    kind=st.sampled_from(LAYOUTS), noise=st.sampled_from([0.0, 2.0]) | st.floats(0, 30), seed=st.integers(0, 2**31 - 1)
)
@settings(max_examples=10)
def test_layouts_with_noise_are_clean(robots, kind, noise, seed):
    world = roomy(robots)
    config = start_of(kind, noise=noise)
    positions = draw(config.prepare(world), jax.random.key(seed), BATCH, world)
    assert positions.shape == (robots, 2, BATCH)
    assert_clean(positions, world)
    centers = layout(config, world)[:, :, None]
    assert (np.abs(positions - centers) <= noise * world.radius + 1e-4).all()


@pytest.mark.parametrize("robots", [2, 13, 40])
@given(
    side=st.floats(14.0, 200.0),
    shape=st.floats(0.5, 2.0),
    spread=st.floats(0.01, 1.0),
    seed=st.integers(0, 2**31 - 1),
)
@settings(max_examples=10)
def test_anywhere_is_clean_however_small_the_window(robots, side, shape, spread, seed):
    """A window too small for the robots would be redrawn for ever."""
    world = roomy(robots, half_width=side, half_height=side * shape)
    assert_clean(draw(UniformStart(spread), jax.random.key(seed), BATCH, world), world)


def test_small_windows_are_as_common_as_large_ones():
    """Two windows, each of a log-uniform share of each side; one robot or more in each, or all in one."""
    world = WorldConfig(robots=40, half_width=1000.0, half_height=1000.0, radius=1e-6)
    positions = draw(UniformStart(0.01), jax.random.key(0), 2000, world)
    # The first robot and the one nearest to it mostly share a window; the median share is that half-way in logarithms.
    apart = np.abs(positions[1:] - positions[:1]).max(axis=1).min(axis=0) / world.half_width
    everywhere = draw(UniformStart(), jax.random.key(0), 2000, world)
    spread_out = np.abs(everywhere[1:] - everywhere[:1]).max(axis=1).min(axis=0) / world.half_width
    assert np.median(apart) < 0.35 * np.median(spread_out)
    at_wall = (np.abs(positions) > 990.0).any(axis=(0, 1)).mean()
    assert at_wall > 0.2
    np.testing.assert_allclose(np.std(everywhere), 1000 / np.sqrt(3), rtol=0.01)


def test_a_configuration_that_got_stuck_is_drawn_anew():
    """Of thirty robots crowded around a circle, every thirtieth draw leaves one of them no place at all."""
    world = WorldConfig(robots=30, half_width=13.0, half_height=13.0)
    positions = draw(ScatteredStart().prepare(world), jax.random.key(1), 512, world)
    assert_clean(np.asarray(positions), world)


def test_the_first_starts_are_the_same_whatever_the_count(monkeypatch):
    """They are drawn in batches of one size, between which Ctrl-C ends the search."""
    world = WorldConfig(robots=24, half_width=6.0, half_height=6.0)
    size = episodes_at_once(24)
    many = draw_starts(UniformStart(), jax.random.key(1), 2 * size + 3, world)
    assert_clean(np.moveaxis(many, 0, -1), world)
    assert len(np.unique(many, axis=0)) == len(many)
    for count in (1, size, size + 1):
        np.testing.assert_array_equal(draw_starts(UniformStart(), jax.random.key(1), count, world), many[:count])
    begun, draw_batch = [], starts._draw

    def interrupted(*args):
        begun.append(args)
        if len(begun) > 1:
            signal.raise_signal(signal.SIGINT)
        return draw_batch(*args)

    monkeypatch.setattr(starts, "_draw", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            draw_starts(UniformStart(), jax.random.key(1), 2 * size + 3, world)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(begun) == 2


@pytest.mark.parametrize(("robots", "episodes"), [(2, 64), (8, 64), (16, 32), (30, 8), (90, 1), (2000, 1)])
def test_what_is_drawn_or_executed_at_once_fits_in_a_cache(robots, episodes):
    assert episodes_at_once(robots) == episodes


def test_noise_is_uniform_within_its_bounds():
    world = roomy(2)
    config = PackedStart(noise=1.5)
    offsets = draw(config.prepare(world), jax.random.key(0), 4096, world) - layout(config, world)[:, :, None]
    assert np.abs(offsets).max() <= 1.5 + 1e-5
    shares = np.histogram(offsets, bins=6, range=(-1.5, 1.5))[0] / offsets.size
    np.testing.assert_allclose(shares, 1 / 6, atol=0.01)


def test_noise_at_the_border_keeps_to_the_part_inside():
    world = WorldConfig(robots=2, half_width=20.0, half_height=20.0)
    config = ScatteredStart(noise=2.0)
    positions = draw(config.prepare(world), jax.random.key(0), 4096, world)
    np.testing.assert_allclose(layout(config, world), [[20, 0], [-20, 0]], atol=1e-12)
    shares = np.histogram(positions[0, 0], bins=4, range=(18, 20))[0] / 4096
    np.testing.assert_allclose(shares, 1 / 4, atol=0.04)


@pytest.mark.parametrize("kind", ["scattered", "random"])
def test_draws_are_determined_by_their_key(kind):
    world = roomy(5)
    start = check_start(start_of(kind), world)
    first, again, other = (draw(start, jax.random.key(seed), 8, world) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()
    assert len(np.unique(np.asarray(first)[0, 0])) == 8, "each of the batch is drawn for itself"


@pytest.mark.parametrize("robots", [2, 7, 10])
def test_scattered_is_an_even_circle(robots):
    world = roomy(robots, half_width=60.0, half_height=45.0)
    points = layout(ScatteredStart(), world)
    np.testing.assert_allclose(np.hypot(*points.T), 45.0)
    turn = np.diff(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
    np.testing.assert_allclose(turn, 2 * np.pi / robots)


@pytest.mark.parametrize("robots", [2, 7, 10, 40])
def test_distributed_is_near_two_opposite_corners(robots):
    world = roomy(robots)
    points = layout(DistributedStart(), world)
    corner = np.array([world.half_width, world.half_height])
    near = [np.abs(points - sign * corner).max(axis=1) < 6 * (robots / 2) ** 0.5 + 6 for sign in (-1, 1)]
    assert near[0].sum() == (robots + 1) // 2
    assert near[1].sum() == robots // 2
    assert (near[0] ^ near[1]).all()


@pytest.mark.parametrize(("robots", "lines"), [(10, 1), (10, 2), (9, 2), (12, 3), (5, 4)])
def test_packed_is_one_line_or_several(robots, lines):
    world = roomy(robots)
    points = layout(PackedStart(lines=lines, spacing=5.0), world)
    rows = np.unique(points[:, 1])
    assert len(rows) <= lines
    assert len(rows) == -(-robots // -(-robots // lines))
    np.testing.assert_allclose(np.diff(rows), 5.0)
    for row in rows:
        np.testing.assert_allclose(np.diff(np.sort(points[points[:, 1] == row, 0])), 5.0)


def test_a_mixture_draws_the_second_by_its_share():
    """The first start is on the left, the second on the right: each draw tells where it comes from."""
    left, right = (JitteredStart(jnp.array([[[x, -5.0], [x, 5.0]]]), noise=1.0) for x in (-30.0, 30.0))
    for share in (0.0, 0.25, 1.0):
        positions = draw(MixtureStart(left, right, share), jax.random.key(2), 4096, UNIT)
        from_right = positions[:, 0] > 0
        assert (from_right[0] == from_right[1]).all(), "a configuration is of one start"
        np.testing.assert_allclose(from_right[0].mean(), share, atol=0.03)


def test_layouts_are_drawn_with_equal_chances():
    points = jnp.stack([jnp.array([[x, -5.0], [x, 5.0]]) for x in (-30.0, 0.0, 30.0)])
    positions = draw(JitteredStart(points), jax.random.key(3), 4096, UNIT)
    assert (positions[:, 0] == positions[:1, 0]).all()
    shares = np.unique(positions[0, 0], return_counts=True)[1] / 4096
    np.testing.assert_allclose(shares, 1 / 3, atol=0.04)


@pytest.mark.parametrize(
    ("kind", "robots"), [*((kind, robots) for kind in LAYOUTS for robots in (60, 2000)), ("random", 90)]
)
def test_too_many_robots_are_an_error_and_no_endless_search(kind, robots):
    world = WorldConfig(robots=robots, half_width=9.0, half_height=9.0)
    message = f"^world.robots = {robots}: must be few enough to fit the {kind} start"
    with pytest.raises(InputError, match=message) as error:
        check_start(start_of(kind), world)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("use", "field", "value"),
    [
        ("scattered", "noise", -1.0),
        ("scattered", "noise", float("nan")),
        ("packed", "noise", float("inf")),
        ("distributed", "spacing", 2.0),
        ("packed", "spacing", float("nan")),
        ("packed", "lines", 0),
        ("random", "min_window", 0.0),
        ("mixture", "share", 1.5),
        ("symmetric", "family", "star"),
    ],
)
def test_no_such_start(use, field, value):
    with pytest.raises(InputError) as error:
        start_of(use, **{field: value})
    assert error.value.field == field
    assert "\n" not in str(error.value)


# Starts of a user's own.


class Pairs(Start):
    """Two robots beside each other, as far apart as asked."""

    gap: float = 4.0
    flaw: str = eqx.field(default="", static=True)

    def sample(self, key, batch, world):
        def propose(key):
            return jax.random.uniform(key, (batch, world.robots, 2), minval=-self.gap, maxval=self.gap)

        points = redraw_overlaps(key, propose, world.radius)
        if self.flaw == "shape":
            return points[:, 1:]
        return {"nan": points * jnp.nan, "integers": points.astype(int), "far": points + 99}.get(self.flaw, points)


def test_a_start_of_ones_own_is_kept_apart_and_checked():
    world = WorldConfig(robots=3, half_width=20.0, half_height=20.0)
    start = check_start(Pairs(), world)
    assert_clean(draw(start, jax.random.key(0), 64, world), world)
    for flaw, message in (
        ("shape", "whose sample returns float32[16, 3, 2], not float32[16, 2, 2]"),
        ("integers", "not int32[16, 3, 2]"),
        ("nan", "a start of finite numbers"),
        ("far", "inside |x| <= 20"),
    ):
        with pytest.raises(InputError) as error:
            check_start(Pairs(flaw=flaw), world)
        assert message in str(error.value)
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"^world.robots = 3: must be few enough to fit"):
        check_start(Pairs(gap=0.5), world)


# Symmetric starts.


def is_kept_by(points, matrix):
    """Whether a linear map takes a configuration onto itself, robots being alike."""
    moved = points @ np.array(matrix, float)
    return bool((np.linalg.norm(moved[:, None] - points[None], axis=2).min(axis=1) < 1e-9).all())


def turn(angle):
    return [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]


@pytest.mark.parametrize("robots", [4, 5, 9, 12, 16])
def test_every_family_has_its_symmetry(robots):
    polygon, line, grid, rings = (symmetric_layout(name, robots) for name in ("polygon", "line", "grid", "rings"))
    assert is_kept_by(polygon, turn(2 * np.pi / robots))
    assert is_kept_by(line, turn(np.pi))
    assert is_kept_by(line, np.diag([1.0, -1.0]))
    assert is_kept_by(grid, np.diag([-1.0, 1.0]))
    assert is_kept_by(rings, turn(2 * np.pi / (robots // 2)))
    for points in (polygon, line, grid, rings):
        assert points.shape == (robots, 2)
        assert distances(points)[~np.eye(robots, dtype=bool)].min() == pytest.approx(1)


@pytest.mark.parametrize("robots", [4, 7, 16])
def test_symmetric_starts_fit_and_differ_in_size_and_direction(robots):
    world = scaled_to(WorldConfig(), robots)
    others = ~np.eye(robots, dtype=bool)
    for name in ("polygon", "line", "grid", "rings"):
        start = SymmetricStart(name)
        starts = draw_starts(check_start(start, world), jax.random.key(1), 50, world)
        assert (np.abs(starts) <= 0.81 * world.half_width).all()
        apart = distances(np.moveaxis(starts, 0, -1))[others].min(axis=0)
        assert (apart >= 3 - 1e-5).all()
        assert len(np.unique(apart)) == 50
        # The shape is the family's: all distances in the same proportion.
        np.testing.assert_allclose(
            distances(starts[3]) / apart[3], distances(symmetric_layout(name, robots)), atol=1e-4
        )
        np.testing.assert_array_equal(starts, draw_starts(start, jax.random.key(1), 50, world))


def test_any_family_is_drawn_with_equal_chances():
    world = scaled_to(WorldConfig(), 8)
    starts = draw_starts(SymmetricStart(), jax.random.key(0), 2000, world).astype(float)
    # A line has no area; a polygon no robot nearer to the middle than another.
    spread = np.linalg.eigvalsh(np.einsum("sri,srj->sij", starts, starts))
    radii = np.linalg.norm(starts, axis=2)
    assert np.mean(spread[:, 0] < 1e-4 * spread[:, 1]) == pytest.approx(1 / 4, abs=0.03)
    assert np.mean(np.ptp(radii, axis=1) < 1e-3) == pytest.approx(1 / 4, abs=0.03)


@pytest.mark.parametrize(
    ("family", "robots", "line"),
    [
        ("rings", 3, "robots = 3: must be at least 4 for the start rings"),
        (
            "line",
            60,
            "world.robots = 60: must be few enough to fit the start line "
            "(or make world.half_width = 45 or world.half_height = 45 larger, or world.radius = 1 smaller)",
        ),
    ],
)
def test_what_cannot_be_symmetric_is_refused(family, robots, line):
    with pytest.raises(InputError) as caught:
        check_start(SymmetricStart(family), WorldConfig(robots=robots))
    assert str(caught.value) == line


# Files of starts.

WORLD = WorldConfig(robots=2, half_width=45.2, half_height=45.2)
HEADER = "start,x,y\n"


def write(tmp_path, text):
    path = tmp_path / "starts.csv"
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    return str(path)


def test_a_file_of_starts_comes_back(tmp_path):
    rng = np.random.default_rng(0)
    world = WorldConfig(robots=6)
    starts = np.stack([4.0 * np.arange(12.0).reshape(6, 2) - 20 + rng.uniform(-0.5, 0.5, (6, 2)) for _ in range(3)])
    rows = [f"{name},{x!r},{y!r}" for name, start in zip("abc", starts.tolist(), strict=True) for x, y in start]
    start = check_start(FileStart(file=write(tmp_path, HEADER + "\n".join(rows)), noise=0.0), world)
    np.testing.assert_array_equal(start.points, starts.astype(np.float32))
    drawn = draw_starts(start, jax.random.key(0), 64, world)
    which = (np.abs(drawn[:, None] - start.points).max(axis=(2, 3)) == 0).argmax(axis=1)
    np.testing.assert_array_equal(drawn, np.asarray(start.points)[which])
    assert set(which) == {0, 1, 2}


def test_rows_may_come_in_any_order_and_columns_too(tmp_path):
    path = write(tmp_path, "y,note,start,x\n1,a,7,2\n3,b,5,4\n\n5,c,7,6\n7,d,5,8\n")
    start = check_start(FileStart(file=path, noise=0.0), WORLD)
    np.testing.assert_array_equal(start.points, [[[2, 1], [6, 5]], [[4, 3], [8, 7]]])


def test_a_robot_on_the_border_is_inside(tmp_path):
    path = write(tmp_path, HEADER + "0,45.2,0\n0,-45.2,-45.2\n")
    start = check_start(FileStart(file=path), WORLD)
    assert_clean(draw(start, jax.random.key(0), BATCH, WORLD), WORLD)


BAD_FILES = {
    "empty": ("", "header start,x,y"),
    "only a header": (HEADER, "at least one start"),
    "no column y": ("start,x\n0,1\n0,9\n", "header start,x,y"),
    "no header": ("0,1,2\n0,5,6\n", "header start,x,y"),
    "text": (HEADER + "0,1,2\n0,five,6\n", "line 3: x = 'five': must be a finite number"),
    "nothing": (HEADER + "0,1,\n0,5,6\n", "line 2: y = ''"),
    "a short row": (HEADER + "0,1\n0,5,6\n", "line 2: y = None"),
    "nan": (HEADER + "0,1,nan\n0,5,6\n", "line 2: y = 'nan'"),
    "infinite": (HEADER + "0,1,2\n0,-1e999,6\n", "line 3: x = '-1e999'"),
    "one robot short": (HEADER + "a,1,2\na,5,6\nb,1,2\n", "start b = '1 robots': must be 2 robots"),
    "one robot too many": (HEADER + "0,1,2\n0,5,6\n0,9,9\n", "'3 robots': must be 2 robots"),
    "overlapping": (HEADER + "0,1,2\n0,5,6\n1,0,0\n1,1.5,0\n", "start 1 = 'overlapping robots': must be more than 2"),
    "touching": (HEADER + "0,0,0\n0,2,0\n", "start 0 = 'overlapping robots'"),
    "coincident": (HEADER + "0,1,1\n0,1,1\n", "start 0 = 'overlapping robots'"),
    "outside": (HEADER + "0,1,2\n0,5,45.3\n", "start 0 = 'a robot outside'"),
    "far outside": (HEADER + "0,1,2\n0,5,1e300\n", "start 0 = 'a robot outside'"),
    "no text": (b"start,x,y\n0,1,\xff\xfe\x00\n", "a readable CSV file"),
    "a field without end": (HEADER + "0,1," + "9" * 200_000, "a readable CSV file"),
    "a quote without end": (HEADER + '0,1,2\n0,"5,6\n0,7,8\n', "line 4: x = '5,6"),
}


@pytest.mark.parametrize(("content", "message"), BAD_FILES.values(), ids=BAD_FILES.keys())
def test_a_bad_file_is_one_line(tmp_path, content, message):
    with pytest.raises(InputError) as error:
        check_start(FileStart(file=write(tmp_path, content)), WORLD)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_cannot_be_read_is_one_line(tmp_path):
    for path, reason in ((tmp_path / "none.csv", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=f"a readable CSV file .{reason}") as error:
            check_start(FileStart(file=str(path)), WORLD)
        assert "\n" not in str(error.value)


def test_a_byte_order_mark_is_no_part_of_the_header(tmp_path):
    file = tmp_path / "starts.csv"
    file.write_text("start,x,y\n7,1,2\n7,3,4\n3,5,6\n3,7,8\n", "utf-8-sig")
    assert file.read_bytes().startswith(b"\xef\xbb\xbf")
    assert read_starts(file, 2).tolist() == [[[1, 2], [3, 4]], [[5, 6], [7, 8]]]
    assert list(read_named_starts(file, 2)) == ["7", "3"]
