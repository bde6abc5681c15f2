"""What a report says in the same words whatever was measured."""

from __future__ import annotations

from murmurate.report.document import Caution
from murmurate.runs.paper import EXPERIMENTS

__all__ = [
    "DIFFERENCES",
    "GAP",
    "PATTERNS",
    "READING",
    "SIZES",
    "STUDY",
    "TITLE",
    "VALID",
    "inconsistencies",
    "quick_caution",
]


def _paragraph(text: str) -> str:
    return " ".join(text.split())


TITLE = "Collisionless patterns in robot swarms: the paper, reproduced"

READING = _paragraph("""
    The experiments are those of “Collisionless Pattern Discovery in Robot Swarms Using Deep Reinforcement Learning”
    (Sharma, Ghosh, Misra, Mukhopadhyay, Sharma). Every one is done with two policies: `central`, the paper's method, is
    one network over all positions; `equivariant` is one set of weights shared by all robots, blind to numbering, place
    and direction. Every run is one training, evaluated greedily on fresh starts with the paper's noise U(-2R, 2R).
""")

VALID = _paragraph("""
    An episode ends in a valid pattern when nobody touched anybody at any moment of any step, nobody left the world, the
    swarm came to rest, every robot neighbours every other, every pair is mutually visible, and no pair is nearer than
    the safe distance. The kinematic bound is the fewest steps in which any controller gets from that start to that
    pattern; efficiency is the bound over the steps taken.
""")

SIZES = _paragraph("""
    The paper prints no sizes; those shown are of the experiments that its authors published. Its steps and ours compare
    only as far as these are its sizes. Where the target is undefined the paper takes a very large scan radius: at least
    the diagonal of the world here.
""")

GAP = _paragraph("""
    The gap is what the mean objective at the end lacks of the best-known pattern's, in percent of it: at 0 % a policy
    forms patterns as good as any that is known.
""")

PATTERNS = _paragraph("""
    The ways are coloured by the policy in charge: blue the base policy, green the auxiliary policy that follows it,
    pink a third policy, where there is one. Shown is a typical episode: that of median steps among the valid
    ones, or among all where none is valid.
""")

STUDY = _paragraph("""
    The paper trains swarms of 4 to 10 robots from distributed and scattered starts and says that the steps vary almost
    linearly with the swarm size. It prints neither the numbers nor the sizes of those worlds. Here R = 1, the safe
    distance is 5, the speed limit 1, the scan radius 20, and X = Y = 20 + 2.5 N: the published 35, 40 and 45 for 6, 8
    and 10 robots lie on this line, and its continuation to other sizes is ours. Every run has the
    objective C1, the equivariant policy and the learner of experiment C, which is its run of ten distributed robots.
""")

DIFFERENCES = (
    "Sizes and hyper-parameters: the paper prints neither. The sizes are its authors' published ones; the numbers of "
    "both learners are ours, chosen by measurement.",
    "F_safe as printed has no real value beyond 2 delta_s + R, and is largest just outside the safe distance. Here "
    "only what lies inside the safe distance is charged.",
    "A collision is a contact at any moment of a step, not only at its end; leaving the world ends an episode too.",
    "Rest: the paper switches policies when the step reward becomes zero; here when its mean over a short window falls "
    "below a tolerance. The steps of that window count.",
    "The clip range stays at 0.2; the paper raises it, by how much it does not say. Value targets are advantage plus "
    "value; the paper prints undiscounted rewards-to-go. The learner `paper` does both as the paper does.",
    "An episode that reaches the time limit is truncated, and the value of its last state is bootstrapped.",
    "While a policy learns, an action may be kept up for some steps; what is learned is executed step by step.",
    "Distributed starts are two opposite corners, the harder reading of “any two of the corners”; packed is one line "
    "half-way between the gathering point and the lower edge.",
    "The equivariant policy bounds the norm of a velocity by the speed limit, the paper each component: diagonally it "
    "is up to sqrt(2) slower than the kinematic bound supposes.",
    "The equivariant learner goes beyond the paper: credit robot by robot, exploration that fades, auxiliary policies "
    "that begin with the weights of the one before, half of the base policy's episodes from anywhere, and, but for a "
    "quick report, a third policy where two do not suffice (in A always).",
)


def inconsistencies() -> tuple[str, ...]:
    """Says which rows of the paper's Table IV do not add up."""
    return tuple(
        f"Row {row.name} of the paper's table does not add up: {row.base_steps:.2f} base steps and "
        f"{row.auxiliary_steps:.2f} auxiliary steps make {row.summed_steps:.2f}, while its total is printed as "
        f"{row.total_steps:.2f}. Both are shown."
        for row in EXPERIMENTS.values()
        if row.total_steps != row.summed_steps
    )


def quick_caution(full: str) -> Caution:
    """Returns what a quick report says on every page.

    Args:
        full: The command that makes the full report.
    """
    banner = f"""Quick report: smaller budgets and fewer swarm sizes. It shows that everything runs, and what the full
        report looks like; its numbers are not the real ones. `{full}` measures those."""
    return Caution(_paragraph(banner), "Quick report, smaller budgets: these numbers are not the real ones.")
