"""The figures of a run as the paper has them: training, the reward of one episode, and the formation of a pattern."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from murmurate.plots.curves import draw_training, draw_training_signals, mark_episode, rest_shown
from murmurate.plots.page import LEFT, WIDTH, add_axes, add_legend, new_page, style_axes
from murmurate.plots.palette import INK, policy_color
from murmurate.plots.panels import draw_panels, draw_run_head
from murmurate.plots.record import Episode, Record

__all__ = ["formation_figure", "reward_figure", "training_figure"]


def training_figure(record: Record) -> Figure:
    """Draws the training of every policy of a run: the mean objective, and the signals that it sums.

    Args:
        record: The run.

    Returns:
        A figure 10 inches wide.
    """
    figure = new_page(4.1)
    draw_run_head(figure, record)
    draw_training(add_axes(figure, LEFT + 0.55, 0.5, 4.1, 2.55), record)
    draw_training_signals(add_axes(figure, WIDTH - LEFT - 4.1, 0.5, 4.1, 2.55), record)
    return figure


def formation_figure(record: Record, episode: int | None = None) -> Figure:
    """Draws the formation of a pattern in one row: start, base pattern, final pattern.

    Args:
        record: The run.
        episode: Which of its evaluation's episodes; the typical one where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no such episode.
    """
    shown = record.episode(episode)
    figure = new_page(4.2)
    draw_run_head(figure, record)
    draw_panels(figure, record, shown, 0.3)
    return figure


def reward_figure(record: Record, episode: int | None = None) -> Figure:
    """Draws the reward that one episode brings, summed up from its start, and step by step.

    The reward is the change of the paper's objective, signals of equal weight, whatever a policy was trained with. What
    comes after the base policy is drawn a second time, larger.

    Args:
        record: The run.
        episode: Which of its evaluation's episodes; the typical one where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no such episode.
    """
    shown = record.episode(episode)
    figure = new_page(4.75)
    draw_run_head(figure, record)
    left, wide, gap, narrow = LEFT + 0.65, 5.2, 0.9, 2.75
    if not shown.switches:
        wide += gap + narrow
    _draw_reward(figure, (left, wide), record, shown, 0)
    if shown.switches:
        _draw_reward(figure, (left + wide + gap, narrow), record, shown, 1)
    return figure


def _draw_reward(figure: Figure, place: tuple[float, float], record: Record, episode: Episode, first: int) -> None:
    """Draws the cumulative reward from the beginning of one policy on, and below it the reward of each step."""
    edges = [0, *episode.switches, episode.steps]
    begin, end = edges[first], episode.steps + rest_shown(episode)
    left, width = place
    upper = add_axes(figure, left, 1.75, width, 1.95)
    lower = add_axes(figure, left, 0.5, width, 1.0)
    title = "Reward of one episode" if first == 0 else "After the base policy"
    style_axes(upper, title, "", "cumulative reward")
    style_axes(lower, "", "steps", "step reward")
    summed = episode.objective.astype(float) - float(episode.objective[begin])
    steps = np.diff(summed)
    for policy, (start, stop) in enumerate(pairwise(edges[first:]), first):
        color = policy_color(policy)
        upper.plot(np.arange(start, stop + 1), summed[start : stop + 1], color=color, linewidth=2.0)
        lower.bar(np.arange(start, stop) + 0.5, steps[start:stop], width=0.85, color=color, linewidth=0)
    upper.plot([episode.steps, end], [summed[-1]] * 2, color=INK, linewidth=2.0)
    lower.axhline(0, color=INK, linewidth=0.8)
    for ax, values in ((upper, summed[begin:]), (lower, steps[begin:])):
        _show(ax, begin, end, values)
        ax.yaxis.set_label_coords(-0.56 / width, 0.5)
        mark_episode(ax, record, episode, first=first, named=ax is upper)
    upper.tick_params(labelbottom=False)
    if first == 0:
        _say_gains(upper, record, summed, edges)


def _show(ax: Axes, begin: float, end: float, values: np.ndarray) -> None:
    """Sets limits that hold all values, and zero."""
    low, high = min(0.0, values.min(initial=0)), max(values.max(initial=0), 1e-3)
    ax.set_xlim(begin, end)
    ax.set_ylim(low - 0.06 * (high - low), high + 0.1 * (high - low))
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def _say_gains(ax: Axes, record: Record, summed: np.ndarray, edges: Sequence[int]) -> None:
    """Says how much reward each policy brought."""
    keys = []
    for place, (start, stop) in enumerate(pairwise(edges)):
        label = f"{record.policies[place]}: {summed[stop] - summed[start]:+.3f}"
        keys.append(Line2D([], [], color=policy_color(place), linewidth=2.0, label=label))
    low, high = ax.get_ylim()
    corner = "lower right" if summed[-1] > (low + high) / 2 else "upper right"
    add_legend(ax, keys, loc=corner, framealpha=0.85)
