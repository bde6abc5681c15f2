"""The model in two figures: what a fat robot is, and which robots see each other, as the kernels have it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle
from matplotlib.patheffects import withStroke

from murmurate import geometry
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
    draw_head,
    new_page,
    policy_color,
)
from murmurate.plots.swarm import draw_robots

__all__ = ["robot_figure", "visibility_figure"]

Point = Float[np.ndarray, "2"]

_RADIUS = 1.0  # the unit of both figures
_SYMBOL = 13.0  # size of the notation, points
_MOVING = policy_color(0)

# The robot that is explained; a neighbour as near as is safe; another neighbour; one that is no neighbour.
_SWARM = np.array([[0.0, 0.0], [3.0, -2.0], [-2.9, -3.4], [-4.2, 3.5]])
_SCAN, _SAFE = 4.9, float(np.hypot(3.0, 2.0))
_VELOCITY, _FASTEST = np.array([1.3, 2.1]), 2.4
_NOTATION = (
    ("$P_n$", "position of its centre"),
    ("$R_{bot}$", "radius of its body, an opaque disc"),
    ("$V_n$", "velocity; each component has its bounds,\nso a step ends in the dashed square"),
    ("$R_{scan}$", "scan radius; robots whose centres\nare this near are its neighbours"),
    (r"$\delta_s$", "safe distance of two centres;\nthe circles of nearer pairs overlap"),
    ("$G_n^{all}$", "number of its neighbours, here {}"),
)


class _Scene(NamedTuple):
    """Three robots: B_k at the origin, B_j that throws a shadow, and B_i.

    Attributes:
        occluder: Centre of B_j.
        observed: Centre of B_i.
        lights: 1: a light at the centre of B_k; 2: another at the centre of B_i.
        note: What the scene shows.
    """

    occluder: tuple[float, float]
    observed: tuple[float, float]
    lights: int
    note: str


_LIGHTS = ("#E69F00", "#56B4E9")
# By whether B_i is occluded from B_k and, with two lights, B_k from B_i.
_TITLES = {
    (True,): "Occluded",
    (False,): "Visible",
    (False, False): "Mutually visible",
    (False, True): "Visible one way only",
    (True, False): "Visible one way only",
    (True, True): "Occluded both ways",
}
_SCENES = (
    _Scene((4.5, -1.0), (10.0, 0.45), 1, "$B_i$ reaches into the shadow that $B_j$ throws in the light of $B_k$"),
    # Slightly outside, so that rounding does not decide.
    _Scene((4.5, -1.0), (10.0, 1.0 + 1e-9), 1, "the limit: $B_i$ touches the shadow, no part of it lies inside"),
    _Scene((2.5, -1.55), (10.0, 0.0), 2, "$B_k$ sees $B_i$, but a part of $B_k$ is hidden from $B_i$"),
    _Scene((5.0, -1.75), (10.0, 0.0), 2, "$B_j$ is near, but no shadow of it reaches $B_i$ or $B_k$"),
)


def robot_figure() -> Figure:
    """Draws a fat robot among others and explains the model's quantities in the paper's notation.

    Returns:
        A figure 10 inches wide.
    """
    figure = new_page(4.75)
    draw_head(figure, "The fat robot", "a disc that others can neither cross nor see through")
    ax = _scene_axes(figure, (LEFT, 0.12, 5.7, 4.08), (-8.3, 6.1))
    ax.set_axis_off()
    edge = {"edgecolor": SIGHT, "linewidth": 1.0}
    ax.add_patch(Circle((0, 0), _SCAN, facecolor=FIELD, linestyle=(0, (4, 2)), zorder=0, **edge))
    for center in _SWARM[:2]:
        ax.add_patch(Circle(tuple(center), _SAFE / 2, fill=False, zorder=1, **edge))
    near = geometry.neighbors(_SWARM, _SCAN)[0]
    draw_robots(ax, _SWARM, _RADIUS, [ROBOT, *(SIGHT if neighbor else FAINT for neighbor in near[1:])], zorder=3)
    for center, inside in zip(_SWARM[2:], near[2:], strict=True):
        text = "centre within:\na neighbour" if inside else "centre outside:\nno neighbour"
        _write(ax, center - (1.25, 0), text, ha="right")
    _draw_velocity(ax)
    _draw_length(ax, _SWARM[1], r"$\delta_s$", (-0.45, -0.4))
    _draw_length(ax, _SCAN * _unit(np.array([-5.7, 1.0])), "$R_{scan}$", (-0.4, 0.5))
    _draw_length(ax, _RADIUS * _unit(np.array([-0.27, -1.0])), "$R_{bot}$", (0.2, -0.42))
    ax.plot(0, 0, "o", color="white", markersize=5, zorder=6)
    _write_symbol(ax, (-0.35, 0.45), "$P_n$", color="white")
    _list_notation(figure, int(near.sum()))
    return figure


def visibility_figure() -> Figure:
    """Draws when a robot is visible: lights at the centres of robots, and the shadow that a third robot throws.

    Returns:
        A figure 10 inches wide.
    """
    figure = new_page(6.1)
    draw_head(figure, "Visibility", "lights at the centres: a robot is occluded when any part of it lies in a shadow")
    width, height = 4.6, 1.95
    for index, scene in enumerate(_SCENES):
        row, column = divmod(index, 2)
        left = LEFT + column * (WIDTH - 2 * LEFT - width)
        ax = _scene_axes(figure, (left, 3.0 - row * 2.8, width, height), (-1.9, 11.9), middle=-0.75)
        for spine in ax.spines.values():
            spine.set(color=FAINT, linewidth=0.8)
        title = f"({'abcd'[index]})  {_draw_scene(ax, scene)}"
        style: dict[str, Any] = {"transform": ax.transAxes}
        ax.text(0, 1.145, title, fontsize=TITLE, fontweight="bold", color=INK, **style)
        ax.text(0, 1.045, scene.note, fontsize=TEXT + 0.5, color=MUTED, **style)
    return figure


def _draw_scene(ax: Axes, scene: _Scene) -> str:
    """Draws B_k, B_j and B_i, the shadow in each light, and the lines of sight; returns what holds of the pair."""
    robots = np.array([(0.0, 0.0), scene.occluder, scene.observed])
    occluded = geometry.occluded(robots, _RADIUS)
    # From B_k to B_i, and back where there is a second light.
    directions = ((0, 2), (2, 0))[: scene.lights]
    hidden = tuple(bool(occluded[direction]) for direction in directions)
    edges = ["none"] * 3
    for (light, observed), blocked, color in zip(directions, hidden, _LIGHTS, strict=False):
        _draw_shadow(ax, robots[light], robots[1], color)
        edges[observed] = WARNING if blocked else "none"
        towards = _unit(robots[observed] - robots[light])
        # Two arrows lie side by side.
        offset = 0.2 * (scene.lights - 1) * np.array([-towards[1], towards[0]])
        start, end = robots[light] + towards + offset, robots[observed] - towards + offset
        _draw_arrow(ax, start, end, WARNING if blocked else INK, width=1.4)
    draw_robots(ax, robots, _RADIUS, edge=edges, linewidth=2.0, zorder=3)
    lit = {light for light, _ in directions}
    for index, name in enumerate("kji"):
        _write_symbol(ax, robots[index] - (0, 0.5 * (index in lit)), f"$B_{name}$", color="white")
    return _TITLES[hidden]


def _draw_shadow(ax: Axes, light: Point, occluder: Point, color: str) -> None:
    """Draws a light, the shadow that a robot throws in it, and the two rays that touch the robot."""
    for size, strength in ((13, 0.25), (9, 0.4), (5.5, 1.0)):
        ax.plot(*light, "o", color=color, markersize=size, alpha=strength, markeredgewidth=0, zorder=6)
    corners = geometry.shadow(light, occluder, _RADIUS, reach=30.0)  # beyond the picture
    ax.add_patch(Polygon(corners, facecolor=SIGHT, edgecolor="none", alpha=0.33, zorder=1))
    for far in corners[1:3]:
        ax.plot([light[0], far[0]], [light[1], far[1]], color=color, linewidth=1.3, zorder=2)


def _draw_velocity(ax: Axes) -> None:
    size = 2 * _FASTEST
    square = Rectangle((-_FASTEST, -_FASTEST), size, size, fill=False, edgecolor=_MOVING, linewidth=0.9, zorder=1)
    square.set_linestyle((0, (2, 2)))
    ax.add_patch(square)
    arrow = _draw_arrow(ax, np.zeros(2), _VELOCITY, _MOVING, width=2.2)
    arrow.set_path_effects([withStroke(linewidth=4.0, foreground="white")])
    _write_symbol(ax, _VELOCITY + np.array([0.5, -0.05]), "$V_n$", color=_MOVING)


def _draw_length(ax: Axes, end: Point, name: str, offset: tuple[float, float]) -> None:
    """Draws a length from the first robot's centre, white within its disc."""
    length = float(np.hypot(*end))
    edge = end * min(1.0, _RADIUS / length)
    ax.plot([0, edge[0]], [0, edge[1]], color="white", linewidth=1.1, zorder=4)
    if length > _RADIUS:
        _draw_arrow(ax, edge, end, INK, width=1.0)
    _write_symbol(ax, (edge + end) / 2 + offset, name, color=INK)


def _list_notation(figure: Figure, neighbors: int) -> None:
    """Explains the symbols at the right of the picture."""
    width, height = figure.get_size_inches()
    left, y = 6.25, 3.95
    for symbol, meaning in _NOTATION:
        style: dict[str, Any] = {"va": "baseline", "color": INK, "math_fontfamily": "stix"}
        figure.text(left / width, y / height, symbol, fontsize=_SYMBOL + 2, **style)
        for line, text in enumerate(meaning.format(neighbors).split("\n")):
            figure.text((left + 0.7) / width, (y - 0.19 * line) / height, text, fontsize=TITLE - 0.5, **style)
        y -= 0.46 + 0.19 * meaning.count("\n")


def _scene_axes(
    figure: Figure, box: tuple[float, float, float, float], span: tuple[float, float], middle: float = 0.0
) -> Axes:
    """Adds axes at a box in inches, to scale and without ticks, that show a span of x around a middle y."""
    ax = add_axes(figure, *box)
    half = (span[1] - span[0]) * box[3] / box[2] / 2
    ax.set(xlim=span, ylim=(middle - half, middle + half), aspect="equal", xticks=[], yticks=[])
    return ax


def _unit(vector: Point) -> Point:
    return vector / np.hypot(*vector)


def _draw_arrow(ax: Axes, start: Point, end: Point, color: str, width: float) -> FancyArrowPatch:
    arrow = FancyArrowPatch(
        tuple(start), tuple(end), arrowstyle="-|>", mutation_scale=8 + 2.5 * width, shrinkA=0, shrinkB=0
    )
    arrow.set(color=color, linewidth=width, zorder=5)
    ax.add_patch(arrow)
    return arrow


def _write_symbol(ax: Axes, position: Any, text: str, **style: Any) -> None:
    """Writes a symbol of the paper's notation."""
    _write(ax, position, text, **{"fontsize": _SYMBOL, "math_fontfamily": "stix"} | style)


def _write(ax: Axes, position: Any, text: str, **style: Any) -> None:
    options: dict[str, Any] = {"fontsize": TEXT, "color": MUTED, "ha": "center", "va": "center", "zorder": 7}
    ax.text(position[0], position[1], text, **options | style)
