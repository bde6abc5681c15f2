"""The figures of one run: its discovery on one page, the formation of a pattern, the training, the reward."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from murmurate.discovery.problem import GATHERING_SIGNALS
from murmurate.plots.recording import Episode, Recording, TrainingCurve, check_recording
from murmurate.plots.style import (
    INK,
    LEFT,
    MUTED,
    NEIGHBORS,
    TEXT,
    TITLE,
    WARNING,
    WIDTH,
    add_axes,
    add_legend,
    draw_head,
    new_page,
    policy_color,
    separate_labels,
    style_axes,
)
from murmurate.plots.swarm import (
    SwarmArtist,
    draw_paths,
    draw_scale,
    draw_sight_key,
    draw_world,
    show_window,
    sight_pairs,
    window,
    world_half_side,
)

__all__ = [
    "describe_goal",
    "describe_sight",
    "describe_swarm",
    "discovery_figure",
    "draw_pattern",
    "formation_figure",
    "pattern_window",
    "reward_figure",
    "training_figure",
]

_SIDE, _GAP = 3.0, 0.25  # of the panels, inches
_BEST = "signal (best: 1)"
# Visibility has the colour that blocked sight has in the patterns.
_SIGNALS = {
    "close": ("#56B4E9", (0, (5, 1.2))),
    "nclose": ("#56B4E9", (0, (5, 1.2))),
    "safety": ("#CC79A7", (0, (3, 1, 1, 1))),
    "neighbors": (NEIGHBORS, (0, (1.2, 1))),
    "visible": (WARNING, "-"),
}
_OTHER_SIGNALS = (("#009E73", (0, (6, 1, 1, 1, 1, 1))), ("#0072B2", (0, (2, 2))), (MUTED, (0, (8, 2))))


def discovery_figure(recording: Recording, episode: int | None = None) -> Figure:
    """Draws a discovery on one page: start, base pattern, final pattern, training, and the signals of that episode.

    Args:
        recording: The run.
        episode: Which of its episodes; the typical one (median steps of the valid ones) where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no such episode.
    """
    check_recording(recording)
    shown = recording.episode(episode)
    figure = new_page(6.95)
    _draw_head(figure, recording)
    _draw_panels(figure, recording, shown, 3.05)
    _draw_training(add_axes(figure, LEFT + 0.5, 0.47, 3.6, 1.75), recording)
    _draw_signals(add_axes(figure, LEFT + 4.82, 0.47, 3.5, 1.75), recording, shown)
    return figure


def formation_figure(recording: Recording, episode: int | None = None) -> Figure:
    """Draws the formation of a pattern in one row: start, base pattern, final pattern.

    Args:
        recording: The run.
        episode: Which of its episodes; the typical one where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no such episode.
    """
    check_recording(recording)
    shown = recording.episode(episode)
    figure = new_page(4.2)
    _draw_head(figure, recording)
    _draw_panels(figure, recording, shown, 0.3)
    return figure


def training_figure(recording: Recording) -> Figure:
    """Draws the training of every policy of a run: the mean objective, and the signals that it sums.

    Returns:
        A figure 10 inches wide.
    """
    check_recording(recording)
    figure = new_page(4.1)
    _draw_head(figure, recording)
    _draw_training(add_axes(figure, LEFT + 0.55, 0.5, 4.1, 2.55), recording)
    ax = add_axes(figure, WIDTH - LEFT - 4.1, 0.5, 4.1, 2.55)
    style_axes(ax, "Signals in training", "environment steps", _BEST)
    curves = _training_curves(recording)
    for steps, curve in curves:
        for index, (name, values) in enumerate(curve.signals.items()):
            color, dashes = _signal_style(name, index)
            label = name if curve is curves[0][1] else None
            ax.plot(steps, values, color=color, linestyle=dashes, linewidth=1.3, label=label)
    _finish_training(ax, recording)
    add_legend(ax, ax.get_legend_handles_labels()[0], loc="lower right", framealpha=0.85)
    return figure


def reward_figure(recording: Recording, episode: int | None = None) -> Figure:
    """Draws the reward of one episode, cumulative and step by step.

    The reward is the change of the objective, whatever weights a policy was trained with. The part after the base
    policy is drawn a second time, larger.

    Args:
        recording: The run.
        episode: Which of its episodes; the typical one where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no such episode.
    """
    check_recording(recording)
    shown = recording.episode(episode)
    figure = new_page(4.75)
    _draw_head(figure, recording)
    left, wide, gap, narrow = LEFT + 0.65, 5.2, 0.9, 2.75
    if not shown.switches:
        wide += gap + narrow
    _draw_reward(figure, (left, wide), recording, shown, 0)
    if shown.switches:
        _draw_reward(figure, (left + wide + gap, narrow), recording, shown, 1)
    return figure


# What a run is, in words


def describe_swarm(recording: Recording) -> str:
    """Returns how many robots start from what."""
    kind = recording.experiment.start.name
    starts = recording.starts or f"{'given' if kind == 'file' else kind} start"
    return f"{recording.experiment.world.robots} robots, {starts}"


def describe_goal(recording: Recording) -> str:
    """Returns where the objective asks the robots to gather, or else the signals that it rewards."""
    if not set(GATHERING_SIGNALS) & set(recording.weights):
        return ", ".join(name for name, weight in recording.weights.items() if weight)
    return "gathering at the origin" if recording.gathering_point else "no predefined point"


def describe_sight(recording: Recording, positions: np.ndarray) -> tuple[str, bool]:
    """Returns how many pairs see each other, in words, and whether all do."""
    world = recording.experiment.world
    pairs = world.robots * (world.robots - 1) // 2
    seen = int(sight_pairs(positions, world)[0].sum())
    return f"{f'all {pairs}' if seen == pairs else f'{seen} of {pairs}'} pairs see each other", seen == pairs


def _draw_head(figure: Figure, recording: Recording) -> None:
    name = recording.experiment.name
    name = name if len(name) <= 24 else name[:23] + "…"
    valid = f"valid: {int(recording.valid.sum())} of {len(recording.valid)} starts"
    draw_head(figure, f"Experiment {name}", f"{describe_swarm(recording)}, {describe_goal(recording)}", valid)


# Panels: configurations of an episode


def pattern_window(recording: Recording, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns centre and half side of the square that shows a pattern with its circles of the safe distance."""
    world = recording.experiment.world
    return window(positions, margin=0.75 * max(world.safe_distance, 2 * world.radius))


def draw_pattern(ax: Axes, recording: Recording, episode: Episode, step: int, square: tuple[np.ndarray, float]) -> None:
    """Draws one configuration of an episode close up: who sees whom, and the paths that led there."""
    world = recording.experiment.world
    show_window(ax, *square)
    draw_world(ax, world)
    draw_paths(ax, episode.positions[: step + 1], episode.policies[:step])
    SwarmArtist(ax, episode.positions[step], world, gathering_point=recording.gathering_point)
    draw_scale(ax, world.safe_distance, f"safe distance {world.safe_distance:g}", TEXT)


def _draw_panels(figure: Figure, recording: Recording, episode: Episode, bottom: float) -> None:
    """Draws in one row the start of an episode, the base policy's pattern if others follow, and the final pattern."""
    panels = [("Start", 0), ("Final pattern", episode.steps)]
    if episode.switches:
        panels.insert(1, (f"{recording.policies[0].capitalize()} pattern", episode.switches[0]))
    left = (WIDTH - len(panels) * _SIDE - (len(panels) - 1) * _GAP) / 2
    windows = [pattern_window(recording, episode.positions[step]) for _, step in panels]
    half = max(extent for _, extent in windows[1:])  # the patterns at one scale
    for index, (title, step) in enumerate(panels):
        ax = add_axes(figure, left + index * (_SIDE + _GAP), bottom, _SIDE, _SIDE)
        title = title if step == 0 else f"{title} · step {step}"
        ax.text(0, 1.085, title, transform=ax.transAxes, fontsize=TITLE, fontweight="bold", color=INK, parse_math=False)
        sight, _ = describe_sight(recording, episode.positions[step])
        ax.text(0, 1.02, sight, transform=ax.transAxes, fontsize=TEXT, color=MUTED)
        if index:
            draw_pattern(ax, recording, episode, step, (windows[index][0], half))
        else:
            _draw_start(ax, recording, episode, (windows[-1][0], half))
            draw_sight_key(ax, TEXT)


def _draw_start(ax: Axes, recording: Recording, episode: Episode, pattern: tuple[np.ndarray, float]) -> None:
    """Draws the whole world with the start, all paths, and the square that the patterns show."""
    world = recording.experiment.world
    show_window(ax, np.zeros(2), world_half_side(world, episode.positions))
    ax.set_frame_on(False)
    draw_world(ax, world, clip=False)
    draw_paths(ax, episode.positions, episode.policies, oldest=0.35, width=0.7)
    center, half = pattern
    square = Rectangle(tuple(center - half), 2 * half, 2 * half, fill=False, edgecolor=MUTED, linewidth=0.8)
    square.set_linestyle((0, (3, 2)))
    ax.add_patch(square)
    swarm = SwarmArtist(ax, episode.positions[0], world, gathering_point=recording.gathering_point, weight=0.5)
    swarm.discs.set_clip_on(False)  # a robot may start with its centre on the edge of the world
    # A bar of 1, 2 or 5 times a power of ten, at most a quarter of the world.
    power = 10.0 ** np.floor(np.log10(world.half_width / 2))
    length = float(max(step * power for step in (1, 2, 5) if step * power <= world.half_width / 2 * (1 + 1e-9)))
    draw_scale(ax, length, f"{length:g} units", TEXT)


# Curves: every signal is 1 at its best, so all share one scale


def _signal_style(name: str, index: int) -> tuple[str, Any]:
    """Returns colour and dashes of a signal's curve; a user's own signals take turns."""
    return _SIGNALS.get(name, _OTHER_SIGNALS[index % len(_OTHER_SIGNALS)])


def _objective_label(recording: Recording) -> str:
    return f"objective / {sum(recording.weights.values()):g}"


def _scaled_objective(recording: Recording, signals: Any) -> np.ndarray:
    return recording.objective(signals) / sum(recording.weights.values())


def _draw_training(ax: Axes, recording: Recording) -> None:
    """Draws the mean objective and the mean visibility of each policy's rollouts against environment steps."""
    style_axes(ax, "Training", "environment steps", _BEST)
    dashes = (0, (2, 1))
    searches = 0 if recording.search is None else 1
    for index, (steps, curve) in enumerate(_training_curves(recording)):
        color = policy_color(max(index - searches, 0))
        ax.plot(steps, _scaled_objective(recording, curve.signals), color=color, linewidth=1.6)
        if "visible" in curve.signals:
            ax.plot(steps, curve.signals["visible"], color=color, linewidth=1.1, linestyle=dashes)
    _finish_training(ax, recording)
    drawn = [Line2D([], [], color=INK, linewidth=1.6, label=_objective_label(recording))]
    if "visible" in recording.weights:
        drawn.append(Line2D([], [], color=INK, linewidth=1.1, linestyle=dashes, label="visible"))
    add_legend(ax, drawn, loc="lower right", framealpha=0.85)


def _training_curves(recording: Recording) -> list[tuple[np.ndarray, TrainingCurve]]:
    """Returns where along the axis of steps each curve of the training is drawn, and the curve.

    A search for goals takes no steps. It is drawn to the left of the first one, in a third of what the others take.
    """
    curves = [(curve.environment_steps, curve) for curve in recording.training]
    search = recording.search
    if search is None:
        return curves
    width = max(curves[-1][0][-1], 1.0) / 3 if curves else 1.0
    share = search.environment_steps / search.environment_steps[-1]
    return [(width * (share - 1), search), *curves]


def _finish_training(ax: Axes, recording: Recording) -> None:
    """Sets the limits of axes of training, and marks which policy was trained when."""
    edges = [0.0, *(float(curve.environment_steps[-1]) for curve in recording.training)]
    names, colors = recording.policies, [policy_color(index) for index in range(len(edges) - 1)]
    _limit(ax, edges[-1])
    ticks = MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(0, max(edges[-1], 1))
    ax.xaxis.set_major_formatter(lambda value, _: _count(value))
    if recording.search is not None:
        edges, names, colors = [_training_curves(recording)[0][0].min(), *edges], ["search", *names], [MUTED, *colors]
        ax.set_xlim(left=edges[0])
    ax.set_xticks([tick for tick in ticks if 0 <= tick <= ax.get_xlim()[1]])
    _mark_spans(ax, edges, colors, names)


def _draw_signals(ax: Axes, recording: Recording, episode: Episode) -> None:
    """Draws the objective and each of its signals during one episode."""
    style_axes(ax, "One episode", "steps", _BEST)
    rest = _rest_shown(episode)

    def with_rest(values: np.ndarray) -> np.ndarray:
        return np.append(values, np.full(rest, values[-1]))

    for index, (name, values) in enumerate(episode.signals.items()):
        color, dashes = _signal_style(name, index)
        ax.plot(with_rest(values), color=color, linestyle=dashes, linewidth=1.3, label=name)
    objective = _scaled_objective(recording, episode.signals)
    ax.plot(with_rest(objective), color=INK, linewidth=2.0, label=_objective_label(recording))
    _limit(ax, episode.steps + rest)
    _mark_episode(ax, recording, episode)
    # Beside the axes, because five curves leave no corner free; in the order in which the curves end.
    ends = {line.get_label(): round(float(np.asarray(line.get_ydata())[-1]), 2) for line in ax.lines}
    handles, labels = ax.get_legend_handles_labels()
    order = sorted(range(len(handles)), key=lambda index: ends[labels[index]], reverse=True)
    add_legend(ax, [handles[i] for i in order], loc="center left", bbox_to_anchor=(1.01, 0.5), framealpha=0.0)


def _draw_reward(
    figure: Figure, horizontal: tuple[float, float], recording: Recording, episode: Episode, first: int
) -> None:
    """Draws the cumulative reward from the beginning of one policy on, and below it the reward of each step."""
    edges = [0, *episode.switches, episode.steps]
    begin, end = edges[first], episode.steps + _rest_shown(episode)
    left, width = horizontal
    upper = add_axes(figure, left, 1.75, width, 1.95)
    lower = add_axes(figure, left, 0.5, width, 1.0)
    style_axes(upper, "After the base policy" if first else "Reward of one episode", "", "cumulative reward")
    style_axes(lower, "", "steps", "step reward")
    objective = recording.objective(episode.signals)
    cumulative = objective - objective[begin]
    rewards = np.diff(objective)
    for policy, (start, stop) in enumerate(pairwise(edges[first:]), first):
        color = policy_color(policy)
        upper.plot(np.arange(start, stop + 1), cumulative[start : stop + 1], color=color, linewidth=2.0)
        lower.bar(np.arange(start, stop) + 0.5, rewards[start:stop], width=0.85, color=color, linewidth=0)
    upper.plot([episode.steps, end], [cumulative[-1]] * 2, color=INK, linewidth=2.0)
    lower.axhline(0, color=INK, linewidth=0.8)
    for ax, values in ((upper, cumulative[begin:]), (lower, rewards[begin:])):
        low, high = min(0.0, values.min(initial=0)), max(values.max(initial=0), 1e-3)
        ax.set(xlim=(begin, end), ylim=(low - 0.06 * (high - low), high + 0.1 * (high - low)))
        ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        ax.yaxis.set_label_coords(-0.56 / width, 0.5)
        _mark_episode(ax, recording, episode, first=first, named=ax is upper)
    upper.tick_params(labelbottom=False)
    if first == 0:
        gains = [cumulative[stop] - cumulative[start] for start, stop in pairwise(edges)]
        handles = [
            Line2D([], [], color=policy_color(i), linewidth=2.0, label=f"{recording.policies[i]}: {gain:+.3f}")
            for i, gain in enumerate(gains)
        ]
        corner = "lower right" if cumulative[-1] > sum(upper.get_ylim()) / 2 else "upper right"
        add_legend(upper, handles, loc=corner, framealpha=0.85)


def _rest_shown(episode: Episode) -> int:
    """Returns how many steps of rest, in which nothing moves, the curves of an episode show after its end."""
    return max(3, round(0.09 * episode.steps))


def _mark_episode(ax: Axes, recording: Recording, episode: Episode, *, first: int = 0, named: bool = True) -> None:
    """Marks which policy was active when, from policy `first` on, and the rest after them."""
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10], integer=True))
    names = [*recording.policies[: len(episode.switches) + 1], episode.outcome]
    colors = [*(policy_color(index) for index in range(len(names) - 1)), MUTED]
    edges = [0, *episode.switches, episode.steps, episode.steps + _rest_shown(episode)]
    _mark_spans(ax, edges[first:], colors[first:], names[first:] if named else [])


def _mark_spans(ax: Axes, edges: Sequence[float], colors: Sequence[str], names: Sequence[str]) -> None:
    """Tints the span between each two edges, draws a line at each inner edge, and names the spans above the axes."""
    for start, end, color in zip(edges[:-1], edges[1:], colors, strict=True):
        ax.axvspan(start, end, color=color, alpha=0.07, linewidth=0, zorder=0)
        if start > edges[0]:
            ax.axvline(start, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), zorder=1)
    texts = []
    for start, end, name, color in zip(edges[:-1], edges[1:], names, colors, strict=False):
        x = ax.transAxes.inverted().transform(ax.transData.transform(((start + end) / 2, 0)))[0]
        style: dict[str, Any] = {"fontsize": TEXT, "color": color, "ha": "center", "va": "bottom", "parse_math": False}
        texts.append(ax.text(x, 1.02, name, transform=ax.transAxes, **style))
    if texts:
        widths = [text.get_window_extent().width / ax.bbox.width for text in texts]
        centers = separate_labels([text.get_position()[0] for text in texts], widths, gap=0.015)
        for text, center in zip(texts, centers, strict=True):
            text.set_x(center)


def _limit(ax: Axes, end: float) -> None:
    """Shows all curves from 0 on, and a little above the best value that a signal can have."""
    lines = [(np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)) for line in ax.lines]
    values = np.concatenate([[0.9], *(y[x >= 0] for x, y in lines)])
    low = float(values[np.isfinite(values)].min())
    ax.set(xlim=(0, max(end, 1)), ylim=(1 - 1.06 * (1 - low), 1 + 0.05 * (1 - low)))


def _count(value: float) -> str:
    """Returns a number of steps in short form: 1,500,000 as 1.5 M."""
    for unit, letter in ((1e6, " M"), (1e3, " k")):
        if abs(value) >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"
