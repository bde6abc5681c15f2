"""Draws the figures of docs/world.md with the library's own geometry: `python docs/draw.py`, or `make figures-docs`."""

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

from murmurate import geometry, view, world
from murmurate.discovery import bound_steps
from murmurate.plots.drawing import draw_key, draw_world, show_window
from murmurate.plots.page import LEFT, TEXT, TITLE, WIDTH, add_axes, add_legend, draw_head, new_page, style_axes
from murmurate.plots.palette import FAINT, INK, MUTED, ROBOT, SIGHT, WARNING, policy_color
from murmurate.runs import presets
from murmurate.world.signals import signals

FOLDER = Path(__file__).parent / "figures" / "world"
DPI = 150  # legible at the width of a page, and small


def sight_figure() -> Figure:
    """Draws what one robot sees, the shadows that its neighbours throw, and on the right who sees whom."""
    radius, scan, safe = 1.0, 11.0, 4.0
    swarm = np.array([[0, 0], [4.5, -1.2], [9.9, 0.2], [-3.2, 4.4], [-5.9, 7.4], [2.2, 7.2], [-6.5, -5.5], [12.4, 5.4]])
    near, seen = (flags[0] for flags in geometry.neighbors_and_visible(swarm, radius, scan))
    figure = new_page(5.35)
    draw_head(
        figure, "Sight", "a light at the centre of one robot: whoever lies in a shadow, in part or whole, is hidden"
    )
    left, right = (add_axes(figure, LEFT + place * 4.85, 0.42, 4.65, 4.1) for place in range(2))
    for ax, title in ((left, "Seen from one robot"), (right, "All pairs of neighbours")):
        show_window(ax, np.array([1.4, 0.0]), 13.0)
        ax.set(ylim=(-13 * 4.1 / 4.65, 13 * 4.1 / 4.65))
        _title(ax, title)
    reach = left.add_patch(Circle((0, 0), scan, facecolor="#F3F6F9", edgecolor=SIGHT, linestyle=(0, (4, 2)), zorder=0))
    for other in swarm[1:][near[1:]]:
        corners = geometry.shadow(swarm[0], other, radius, reach=2 * scan)
        shade = left.add_patch(Polygon(corners, facecolor=SIGHT, edgecolor="none", alpha=0.4, zorder=1))
        shade.set_clip_path(reach)
    for place, center in enumerate(swarm):
        lit = place == 0 or seen[place]
        edge = "none" if lit else WARNING if near[place] else MUTED
        body = ROBOT if place == 0 or near[place] else "white"
        left.add_patch(Circle(tuple(center), radius, facecolor=body, edgecolor=edge, linewidth=1.8, zorder=3))
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
    view.draw_configuration(right, swarm, radius, scan, safe)
    draw_key(right, TEXT)
    return figure


def contact_figure() -> Figure:
    """Draws a step whose two ends are clean and whose middle is not, and the distance of the two centres during it."""
    radius = 1.0
    start = np.array([[-0.53, 1.53], [-0.47, -0.53]]) + np.array([0.5, -0.5])
    velocities = np.array([[-1.0, -1.0], [1.0, 1.0]])
    least = geometry.closest_approach(start, velocities)[0, 1]
    times = np.linspace(0, 1, 201)
    gaps = np.array([geometry.distances(start + time * velocities)[0, 1] for time in times])
    closest = times[gaps.argmin()]
    figure = new_page(3.15)
    draw_head(figure, "Contact", "both ends of the step are clean; in between the discs overlap")
    for place, (time, name) in enumerate(((0.0, "start"), (closest, "closest approach"), (1.0, "end"))):
        ax = add_axes(figure, LEFT + place * 2.15, 0.3, 2.0, 2.0)
        show_window(ax, np.zeros(2), 2.5)
        now = start + time * velocities
        clean = geometry.distances(now)[0, 1] > 2 * radius
        for center, velocity, first in zip(now, velocities, start, strict=True):
            ax.plot(*zip(first, center, strict=True), color=policy_color(0), linewidth=1.4, zorder=2)
            disc = {"facecolor": ROBOT, "alpha": 0.85, "edgecolor": "none" if clean else WARNING, "linewidth": 1.8}
            ax.add_patch(Circle(tuple(center), radius, zorder=3, **disc))
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
    """Draws the signals of regular rings of every size, and three of these rings, with what they lack."""
    sizes = presets.preset("C").world
    angles = 2 * np.pi * np.arange(sizes.robots) / sizes.robots
    ring = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    radii = np.linspace(3.5, 14, 600)
    fixed = {name: getattr(sizes, name) for name in _MEASURED}
    curves = {}
    for gathering in ("close", "nclose"):
        curves |= signals(ring[:, :, None] * radii, gathering=gathering, **fixed)
    figure = new_page(6.0)
    draw_head(figure, "Signals", "ten robots on a regular ring, sizes of experiment C")
    ax = add_axes(figure, 0.75, 3.28, 7.3, 2.0)
    style_axes(ax, "", "radius of the ring", "signal", pad=0)
    styles = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)))
    order = ("close", "nclose", "safety", "neighbors", "visible")
    for place, name in enumerate(order):
        ax.plot(radii, curves[name], color=policy_color(place), linestyle=styles[place], linewidth=1.9, label=name)
    good = radii[(np.stack([curves[name] for name in order[2:]]) > 1 - 1e-9).all(axis=0)]
    ax.axvspan(good.min(), good.max(), color=FAINT, alpha=0.45, linewidth=0)
    ax.text(good.mean(), 0.06, "valid", color=INK, fontsize=TEXT, ha="center")
    ax.set(xlim=(radii[0], radii[-1]), ylim=(0, 1.04), yticks=[0, 0.5, 1])
    add_legend(ax, ax.get_lines()[:5], loc="center left", bbox_to_anchor=(1.02, 0.5))
    half = 0.5 * sizes.safe_distance + 11.8
    for place, radius in enumerate((5.0, 9.0, 11.8)):
        panel = add_axes(figure, LEFT + place * 3.3, 0.15, 2.75, 2.3)
        show_window(panel, np.zeros(2), half)
        panel.set(xlim=(-half * 2.75 / 2.3, half * 2.75 / 2.3))
        positions = radius * ring
        view.draw_configuration(panel, positions, sizes.radius, sizes.scan_radius, sizes.safe_distance, "C1")
        _title(panel, f"radius {radius:g}: {_lacks(positions, sizes)}")
    return figure


def starts_figure() -> Figure:
    """Draws starts of every kind, each with its noise, in the world of experiment C."""
    sizes = presets.preset("C").world
    kinds = ("scattered", "distributed", "packed", "random")
    figure = new_page(5.85)
    draw_head(figure, "Starts", "ten robots, the whole world; below, exactly symmetric starts")
    for place, kind in enumerate(kinds):
        start = world.make_start(world.StartConfig(kind=kind), sizes)
        _world_panel(figure, place, 2.9, world.draw_starts(start, jax.random.key(3), 1)[0], kind, sizes)
    for place, name in enumerate(("polygon", "line", "grid", "rings")):
        points = world.symmetric_starts(name, sizes, 1, 0)[0]
        _world_panel(figure, place, 0.2, points, name, sizes)
    return figure


def bound_figure() -> Figure:
    """Draws the ways from a start to a pattern, robots as they are numbered and robots as they are interchangeable."""
    sizes = presets.preset("C").world
    start = world.draw_starts(world.make_start(world.StartConfig(kind="distributed"), sizes), jax.random.key(3), 1)[0]
    angles = 2 * np.pi * (np.arange(sizes.robots) + 0.5) / sizes.robots
    final = 8.7 * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    cost = np.abs(start[:, None] - final[None]).max(axis=2)
    bound = bound_steps(start, final, sizes.max_speed)
    places = maximum_bipartite_matching(csr_array(cost <= bound * sizes.max_speed * (1 + 1e-9)), perm_type="column")
    figure = new_page(5.05)
    draw_head(figure, "Kinematic bound", "robots are interchangeable: the longest way is as short as it can be")
    for place, (name, goals) in enumerate((("as they are numbered", np.arange(sizes.robots)), ("bound", places))):
        ax = add_axes(figure, LEFT + 0.4 + place * 4.75, 0.25, 4.0, 4.0)
        show_window(ax, np.zeros(2), sizes.half_width)
        ax.set_frame_on(False)
        draw_world(ax, sizes, whole=True)
        ways = cost[np.arange(sizes.robots), goals]
        for robot, goal in enumerate(goals):
            color, width = (policy_color(0), 2.2) if ways[robot] == ways.max() else (SIGHT, 0.9)
            ax.plot(*zip(start[robot], final[goal], strict=True), color=color, linewidth=width, zorder=1)
        for points, body in ((start, "white"), (final, ROBOT)):
            for point in points:
                disc = Circle(tuple(point), sizes.radius, facecolor=body, edgecolor=ROBOT, linewidth=1.0, zorder=3)
                ax.add_patch(disc).set_clip_on(False)
        _title(ax, f"{name}: {ways.max() / sizes.max_speed:.1f} steps")
    return figure


FIGURES = {
    "sight": sight_figure,
    "contact": contact_figure,
    "signals": signals_figure,
    "starts": starts_figure,
    "bound": bound_figure,
}
_MEASURED = ("half_width", "half_height", "radius", "scan_radius", "safe_distance")


def _lacks(positions: np.ndarray, sizes: world.WorldConfig) -> str:
    """Says what a configuration lacks of a valid pattern."""
    others = ~np.eye(len(positions), dtype=bool)
    near, seen = geometry.neighbors_and_visible(positions, sizes.radius, sizes.scan_radius)
    lacks = {
        "too near": (geometry.distances(positions)[others] < sizes.safe_distance).any(),
        "not gathered": not near[others].all(),
        "occluded": not seen[near].all(),
    }
    return ", ".join(name for name, found in lacks.items() if found) or "valid"


def _world_panel(
    figure: Figure, place: int, bottom: float, points: np.ndarray, name: str, sizes: world.WorldConfig
) -> None:
    """Draws a start in the whole world."""
    side = (WIDTH - 2 * LEFT - 3 * 0.3) / 4
    ax = add_axes(figure, LEFT + place * (side + 0.3), bottom, side, side)
    show_window(ax, np.zeros(2), sizes.half_width)
    ax.set_frame_on(False)
    draw_world(ax, sizes, whole=True)
    ax.plot(0, 0, "+", color=INK, markersize=7, markeredgewidth=1.1)
    for point in points:
        ax.add_patch(Circle(tuple(point), sizes.radius, facecolor=ROBOT, zorder=3)).set_clip_on(False)
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
    """How the words of a key look under a picture."""
    small = {"borderpad": 0, "borderaxespad": 0, "handletextpad": 0.4, "columnspacing": 1.2, "handlelength": 1.6}
    return {"fontsize": TEXT, "labelcolor": MUTED, "frameon": False, **small}


def main(arguments: Sequence[str]) -> None:
    """Draws all figures into a folder, by default the one that the page shows."""
    folder = Path(arguments[0]) if arguments else FOLDER
    for name, draw in FIGURES.items():
        view.save(draw(), folder / f"{name}.png", dpi=DPI)


if __name__ == "__main__":
    main(sys.argv[1:])
