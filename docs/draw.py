"""Draws the figures of docs/world.md with the library's own geometry: `python docs/draw.py`, or `make figures-docs`.

The animation of the README is made by

    murmurate show --robots 8 --start packed --animation docs/figures/swarm.webp
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Polygon
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from murmurate import geometry, plots, world
from murmurate.discovery import bound_steps
from murmurate.plots.style import (
    FAINT,
    FIELD,
    INK,
    LEFT,
    MUTED,
    ROBOT,
    SIGHT,
    TEXT,
    TITLE,
    WARNING,
    WIDTH,
    add_axes,
    add_legend,
    draw_head,
    new_page,
    policy_color,
    style_axes,
)
from murmurate.plots.swarm import draw_robots, draw_sight_key, draw_world, show_window
from murmurate.runs import presets

FOLDER = Path(__file__).parent / "figures" / "world"
DPI = 150  # legible at the width of a page, and small


def sight_figure() -> Figure:
    """Draws what one robot sees, the shadows that its neighbours throw, and on the right who sees whom."""
    sizes = world.WorldConfig(robots=8, radius=1.0, scan_radius=11.0, safe_distance=4.0)
    radius, scan = sizes.radius, sizes.scan_radius
    swarm = np.array([[0, 0], [4.5, -1.2], [9.9, 0.2], [-3.2, 4.4], [-5.9, 7.4], [2.2, 7.2], [-6.5, -5.5], [12.4, 5.4]])
    near, seen = (flags[0] for flags in geometry.neighbors_and_visible(swarm, radius, scan))
    figure = new_page(5.35)
    draw_head(
        figure, "Sight", "a light at the centre of one robot: a robot is hidden when any part of it lies in a shadow"
    )
    left, right = (add_axes(figure, LEFT + column * 4.85, 0.42, 4.65, 4.1) for column in range(2))
    for ax, title in ((left, "Seen from one robot"), (right, "All pairs of neighbours")):
        show_window(ax, np.array([1.4, 0.0]), 13.0)
        ax.set(ylim=(-13 * 4.1 / 4.65, 13 * 4.1 / 4.65))
        _title(ax, title)
    reach = left.add_patch(Circle((0, 0), scan, facecolor=FIELD, edgecolor=SIGHT, linestyle=(0, (4, 2)), zorder=0))
    for other in swarm[1:][near[1:]]:
        corners = geometry.shadow(swarm[0], other, radius, reach=2 * scan)
        shade = left.add_patch(Polygon(corners, facecolor=SIGHT, edgecolor="none", alpha=0.4, zorder=1))
        shade.set_clip_path(reach)
    bodies = [ROBOT, *(ROBOT if neighbor else "white" for neighbor in near[1:])]
    edges = ["none", *("none" if s else WARNING if n else MUTED for s, n in zip(seen[1:], near[1:], strict=True))]
    draw_robots(left, swarm, radius, bodies, edges, linewidth=1.8, zorder=3)
    for size, strength in ((12, 0.3), (8, 0.5), (5, 1.0)):
        left.plot(0, 0, "o", color="#E69F00", markersize=size, alpha=strength, markeredgewidth=0, zorder=6)
    disc: dict[str, Any] = {"marker": "o", "linestyle": "none", "markersize": 8, "markeredgewidth": 1.6}
    keys = [
        Line2D([], [], color=ROBOT, label="visible", markeredgecolor="none", **disc),
        Line2D([], [], color=ROBOT, label="occluded", markeredgecolor=WARNING, **disc),
        Line2D([], [], color="white", label="no neighbour", markeredgecolor=MUTED, **disc),
        Line2D([], [], color=SIGHT, linestyle=(0, (4, 2)), label="scan radius"),
    ]
    left.legend(handles=keys, ncols=4, loc="upper left", bbox_to_anchor=(0, -0.015), **_quiet())
    plots.SwarmArtist(right, swarm, sizes)
    draw_sight_key(right, TEXT)
    return figure


def contact_figure() -> Figure:
    """Draws a step with a contact in its middle only, and the distance of the two centres during it."""
    radius = 1.0
    start = np.array([[-0.53, 1.53], [-0.47, -0.53]]) + np.array([0.5, -0.5])
    velocities = np.array([[-1.0, -1.0], [1.0, 1.0]])
    least = geometry.closest_approach(start, velocities)[0, 1]
    times = np.linspace(0, 1, 201)
    gaps = np.array([geometry.distances(start + time * velocities)[0, 1] for time in times])
    closest = times[gaps.argmin()]
    figure = new_page(3.15)
    draw_head(figure, "Contact", "the discs are apart at both ends of the step, and overlap in between")
    for column, (time, name) in enumerate(((0.0, "start"), (closest, "closest approach"), (1.0, "end"))):
        ax = add_axes(figure, LEFT + column * 2.15, 0.3, 2.0, 2.0)
        show_window(ax, np.zeros(2), 2.5)
        now = start + time * velocities
        apart = geometry.distances(now)[0, 1] > 2 * radius
        draw_robots(ax, now, radius, edge="none" if apart else WARNING, linewidth=1.8, zorder=3).set_alpha(0.85)
        for center, velocity, first in zip(now, velocities, start, strict=True):
            ax.plot(*zip(first, center, strict=True), color=policy_color(0), linewidth=1.4, zorder=2)
            if time == 0:
                ax.add_patch(_arrow(center, center + velocity))
        _title(ax, f"t = {time:.2g}: {name}")
    ax = add_axes(figure, LEFT + 6.95, 0.62, 2.5, 1.68)
    style_axes(ax, "", "time within the step", "distance of the centres", pad=0)
    ax.plot(times, gaps, color=policy_color(0), linewidth=1.8)
    ax.axhline(2 * radius, color=WARNING, linewidth=1.2, linestyle=(0, (4, 2)))
    ax.fill_between(times, gaps, 2 * radius, where=gaps <= 2 * radius, color=WARNING, alpha=0.18, linewidth=0)
    ax.plot(closest, least, "o", color=WARNING, markersize=5)
    ax.text(0.5, 2 * radius + 0.03, "2 R: contact", color=WARNING, fontsize=TEXT, ha="center", va="bottom")
    ax.text(closest, least - 0.06, f"closest approach {least:.2f}", color=INK, fontsize=TEXT, ha="center", va="top")
    ax.set(xlim=(0, 1), ylim=(1.25, 2.25), xticks=[0, 0.5, 1], yticks=[1.5, 2.0])
    _title(ax, "Distance during the step")
    return figure


def signals_figure() -> Figure:
    """Draws the signals of regular rings of every size, and three of these rings with what makes them invalid."""
    sizes = presets.preset("C").world
    angles = 2 * np.pi * np.arange(sizes.robots) / sizes.robots
    ring = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    radii = np.linspace(3.5, 14, 600)
    order = ("close", "nclose", "safety", "neighbors", "visible")
    configuration = world.Configuration(ring[:, :, None] * radii, sizes)
    curves = {name: world.Signal.registered()[name]().value(configuration) for name in order}
    figure = new_page(6.0)
    draw_head(figure, "Signals", "ten robots on a regular ring, sizes of experiment C")
    ax = add_axes(figure, 0.75, 3.28, 7.3, 2.0)
    style_axes(ax, "", "radius of the ring", "signal", pad=0)
    styles = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)))
    for index, name in enumerate(order):
        ax.plot(radii, curves[name], color=policy_color(index), linestyle=styles[index], linewidth=1.9, label=name)
    good = radii[(np.stack([curves[name] for name in order[2:]]) > 1 - 1e-9).all(axis=0)]
    ax.axvspan(good.min(), good.max(), color=FAINT, alpha=0.45, linewidth=0)
    ax.text(good.mean(), 0.06, "valid", color=INK, fontsize=TEXT, ha="center")
    ax.set(xlim=(radii[0], radii[-1]), ylim=(0, 1.04), yticks=[0, 0.5, 1])
    add_legend(ax, ax.get_lines()[:5], loc="center left", bbox_to_anchor=(1.02, 0.5))
    half = 0.5 * sizes.safe_distance + 11.8
    for column, radius in enumerate((5.0, 9.0, 11.8)):
        panel = add_axes(figure, LEFT + column * 3.3, 0.15, 2.75, 2.3)
        show_window(panel, np.zeros(2), half)
        panel.set(xlim=(-half * 2.75 / 2.3, half * 2.75 / 2.3))
        positions = radius * ring
        plots.SwarmArtist(panel, positions, sizes, gathering_point=True)
        _title(panel, f"radius {radius:g}: {_lacks(positions, sizes)}")
    return figure


def starts_figure() -> Figure:
    """Draws starts of every kind, each with its noise, in the world of experiment C."""
    sizes = presets.preset("C").world
    kinds = ("scattered", "distributed", "packed", "random")
    figure = new_page(5.85)
    draw_head(figure, "Starts", "ten robots, the whole world; below, exactly symmetric starts")
    for column, kind in enumerate(kinds):
        start = world.Start.registered()[kind]()
        _world_panel(figure, column, 2.9, _draw_start(start, sizes), kind, sizes)
    for column, name in enumerate(("polygon", "line", "grid", "rings")):
        _world_panel(figure, column, 0.2, _draw_start(world.SymmetricStart(family=name), sizes), name, sizes)
    return figure


def hard_starts_figure() -> Figure:
    """Draws the first configuration of sets of starts: of ten robots, and of sixteen."""
    figure = new_page(5.85)
    draw_head(figure, "Hard starts", "the first of each set: ten robots, and sixteen in their larger world")
    panels = [(family, 10) for family in ("cluster", "corner", "wall", "walls", "tight-grid")]
    for index, (family, robots) in enumerate([*panels, *((family, 16) for family in ("cluster", "corner", "wall"))]):
        sizes = world.start_sets.set_world(robots)
        title = family if robots == 10 else f"{family}, {robots} robots"
        positions = world.start_set(family, robots, 1)[0].astype(float)
        _world_panel(figure, index % 4, 2.9 if index < 4 else 0.2, positions, title, sizes)
    return figure


def bound_figure() -> Figure:
    """Draws the paths from a start to a pattern, for numbered robots and for interchangeable ones."""
    sizes = presets.preset("C").world
    start = _draw_start(world.DistributedStart(), sizes)
    angles = 2 * np.pi * (np.arange(sizes.robots) + 0.5) / sizes.robots
    final = 8.7 * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    cost = np.abs(start[:, None] - final[None]).max(axis=2)
    bound = bound_steps(start, final, sizes.max_speed)
    shortest = maximum_bipartite_matching(csr_array(cost <= bound * sizes.max_speed * (1 + 1e-9)), perm_type="column")
    figure = new_page(5.05)
    draw_head(figure, "Kinematic bound", "robots are interchangeable: the longest path is as short as it can be")
    for column, (name, goals) in enumerate((("numbered robots", np.arange(sizes.robots)), ("bound", shortest))):
        ax = add_axes(figure, LEFT + 0.4 + column * 4.75, 0.25, 4.0, 4.0)
        show_window(ax, np.zeros(2), sizes.half_width)
        ax.set_frame_on(False)
        draw_world(ax, sizes, clip=False)
        lengths = cost[np.arange(sizes.robots), goals]
        for robot, goal in enumerate(goals):
            color, width = (policy_color(0), 2.2) if lengths[robot] == lengths.max() else (SIGHT, 0.9)
            ax.plot(*zip(start[robot], final[goal], strict=True), color=color, linewidth=width, zorder=1)
        for points, body in ((start, "white"), (final, ROBOT)):
            draw_robots(ax, points, sizes.radius, body, ROBOT, linewidth=1.0, zorder=3).set_clip_on(False)
        _title(ax, f"{name}: {lengths.max() / sizes.max_speed:.1f} steps")
    return figure


FIGURES = {
    "sight": sight_figure,
    "contact": contact_figure,
    "signals": signals_figure,
    "starts": starts_figure,
    "hard-starts": hard_starts_figure,
    "bound": bound_figure,
}


def _draw_start(start: world.Start, sizes: world.WorldConfig) -> np.ndarray:
    return world.draw_starts(start.prepare(sizes), jax.random.key(3), 1, sizes)[0]


def _lacks(positions: np.ndarray, sizes: world.WorldConfig) -> str:
    """Returns what keeps a configuration from being a valid pattern."""
    others = ~np.eye(len(positions), dtype=bool)
    near, seen = geometry.neighbors_and_visible(positions, sizes.radius, sizes.scan_radius)
    lacks = {
        "too near": (geometry.distances(positions)[others] < sizes.safe_distance).any(),
        "not gathered": not near[others].all(),
        "occluded": not seen[near].all(),
    }
    return ", ".join(name for name, present in lacks.items() if present) or "valid"


def _world_panel(
    figure: Figure, column: int, bottom: float, points: np.ndarray, name: str, sizes: world.WorldConfig
) -> None:
    """Draws a start in the whole world."""
    side = (WIDTH - 2 * LEFT - 3 * 0.3) / 4
    ax = add_axes(figure, LEFT + column * (side + 0.3), bottom, side, side)
    show_window(ax, np.zeros(2), sizes.half_width)
    ax.set_frame_on(False)
    draw_world(ax, sizes, clip=False)
    ax.plot(0, 0, "+", color=INK, markersize=7, markeredgewidth=1.1)
    draw_robots(ax, points, sizes.radius, linewidth=0, zorder=3).set_clip_on(False)
    _title(ax, name)


def _title(ax: Axes, text: str) -> None:
    """Writes a title a few points above the upper left corner, however large the axes are."""
    style: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "bottom"}
    ax.annotate(text, (0, 1), (0, 5), fontsize=TITLE, fontweight="bold", color=INK, **style)


def _arrow(start: np.ndarray, end: np.ndarray) -> FancyArrowPatch:
    arrow = FancyArrowPatch(tuple(start), tuple(end), arrowstyle="-|>", mutation_scale=11, shrinkA=0, shrinkB=0)
    arrow.set(color=policy_color(4), linewidth=1.6, zorder=5)
    return arrow


def _quiet() -> dict[str, Any]:
    """Returns the look of a key below a picture."""
    small = {"borderpad": 0, "borderaxespad": 0, "handletextpad": 0.4, "columnspacing": 1.2, "handlelength": 1.6}
    return {"fontsize": TEXT, "labelcolor": MUTED, "frameon": False, **small}


def main(arguments: Sequence[str]) -> None:
    """Draws all figures into a folder, by default the one that the page shows."""
    folder = Path(arguments[0]) if arguments else FOLDER
    for name, draw in FIGURES.items():
        plots.save(draw(), folder / f"{name}.png", dpi=DPI)


if __name__ == "__main__":
    main(sys.argv[1:])
