"""Operations and bytes of a world step and of an update, counted by hand, and the time that they take at the least.

What is counted is what the code does, as it is written: a smarter way to the same result has a lower floor. Every count
is of one world. Four kinds of operations are told apart because a machine does them at different rates: additions and
multiplications of matrix products; plain ones (additions, multiplications, comparisons, choices, logic); roots and
quotients; and functions (exponentials, logarithms, tangents, inverse error functions as one each).

Bytes are those that have to pass: arguments are read once, results are written once, all else stays near the processor.
"""

from __future__ import annotations

import itertools
from dataclasses import astuple, dataclass

from benchmarks import ceilings
from murmurate.learning import PPOConfig
from murmurate.policies import PolicyConfig
from murmurate.policies.features import SHADOW_CHANNELS, pair_channels, robot_channels

__all__ = ["Rates", "Work", "floor", "networks", "step", "update"]

FLOAT, FLAG = 4, 1
"""Bytes of a number and of a truth value."""


@dataclass(frozen=True)
class Work:
    """How much there is to do.

    Attributes:
        products: Additions and multiplications in matrix products.
        plain: Other additions and multiplications, comparisons, choices and logic.
        roots: Square roots and quotients.
        functions: Exponentials and the like.
        bytes: Bytes read and written.
    """

    products: float = 0
    plain: float = 0
    roots: float = 0
    functions: float = 0
    bytes: float = 0

    @property
    def operations(self) -> float:
        """Operations of all kinds."""
        return self.products + self.plain + self.roots + self.functions

    def __add__(self, other: Work) -> Work:
        return Work(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __rmul__(self, times: float) -> Work:
        return Work(*(times * a for a in astuple(self)))


@dataclass(frozen=True)
class Rates:
    """What the machine does in a second, of each field of `Work`; see `ceilings`."""

    products: float
    plain: float
    roots: float
    functions: float
    bytes: float

    @classmethod
    def of(cls, measured: dict[str, float]) -> Rates:
        """Takes them from the ceilings by name: of plain work, the faster of the two kinds."""
        return cls(
            products=measured[ceilings.PRODUCTS],
            plain=max(measured[ceilings.PLAIN], measured[ceilings.VARIED]),
            roots=measured[ceilings.ROOTS],
            functions=measured[ceilings.FUNCTIONS],
            bytes=measured[ceilings.COPY],
        )


def floor(work: Work, rates: Rates) -> tuple[float, str]:
    """Returns the fewest seconds that the work can take, and what bounds it: operations or bytes.

    All operations are the same processor's, so their times add up; bytes pass meanwhile.
    """
    *operations, moved = (amount / rate for amount, rate in zip(astuple(work), astuple(rates), strict=True))
    return max((sum(operations), "operations"), (moved, "bytes"))


# The world.

OFFSETS = Work(plain=5, roots=1)
"""Of a pair: two differences, the sum of their squares, and its root."""

SIGHT_LINE = Work(plain=9, roots=4)
"""Of a pair: unit vector (two quotients), sine and cosine of its half-width (quotient, root), and what guards them."""

SHADOW = Work(plain=20)
"""Of a triple: cosine and sine of the angle between (3, 4), of the sum of half-widths (3, 3), who is nearer (1),
whether they overlap (3), logic (3)."""

CONTACT = Work(plain=24, roots=4)
"""Of a pair: offsets of places and velocities (8, root), unit of the relative velocity (3, two quotients, 2 guards),
how far it goes (3 + 3), where that is (4), how near (3, root), whether that touches (3)."""


def step(robots: int, by_robot: bool = False) -> Work:
    """One step of one world with all its signals, and each robot's share of them if asked for."""
    pairs, triples = robots**2, robots**3
    # A component: bounded twice, added. A robot: distance from the origin (4, root), whether it is outside (7).
    motion = Work(plain=robots * (2 * 3 + 4 + 7), roots=robots)
    # Who is near (2), who is seen (2), how many of both (4), the charge for being too near (3, root).
    measured = pairs * (OFFSETS + SIGHT_LINE + Work(plain=11, roots=1)) + triples * SHADOW
    # The objective and its change, ends, credit.
    outcome = Work(plain=24)
    numbers = 2 * robots + 4
    moved = Work(bytes=FLOAT * (2 * numbers + 2 * robots + 6) + 2 * FLAG)
    done = motion + measured + pairs * CONTACT + outcome + moved
    return done + shares(robots) if by_robot else done


def shares(robots: int) -> Work:
    """What each robot's share of the signals takes beyond the signals themselves."""
    # A triple: the shadow as a number, how many hide, who does (1 + 1 + 2), and by whom each pair is hidden (3).
    hidden = robots**3 * Work(plain=7)
    # A pair: hidden by one alone and near (4), sums of those over robots (1), of flags in both directions (3).
    return hidden + robots**2 * Work(plain=8) + robots * Work(plain=16, roots=1) + Work(bytes=2 * FLOAT * robots)


# The networks. A layer is a matrix product, a bias, and a tangent.


def layer(features: float, out: float, tangent: bool = True) -> Work:
    """One vector through one layer."""
    return Work(products=2 * features * out, plain=out, functions=out if tangent else 0)


def backward(forward: Work, weights: float, first: bool) -> Work:
    """What a layer's gradients take: by its weights, and by its inputs unless they are the observation itself.

    Args:
        forward: The layer's forward pass over all vectors.
        weights: How many tangents have to be derived (3 operations each) and biases summed: the plain count.
        first: Whether its inputs are the observation.
    """
    return Work(products=forward.products * (1 if first else 2), plain=4 * weights)


def features(robots: int, basis: int, landmark: bool = True) -> Work:
    """What the equivariant networks are told of a configuration: nothing in it is learned, so nothing of it derived."""
    pairs, triples = robots**2, robots**3
    # Offset (5, root), unit vector and guards (4, two quotients), logarithm (2, quotient), sums over others (4).
    pair = Work(plain=15, roots=4, functions=1)
    # A basis function: place, bell (4, exponential), mask; sums of it and of its two directions (5).
    radial = basis * Work(plain=10, functions=1)
    # The rings two by two, and where the other lies in each (3 + 3, guards).
    rings = (basis // 2) * Work(plain=6)
    # A third robot: offset (4, quotient), cosine (3), bell (4, quotient), nearer, ahead, behind (8), six sums (9).
    third = Work(plain=28, roots=2)
    around = Work(plain=SHADOW_CHANNELS)
    robot = Work(plain=7 * basis, roots=basis)
    place = Work(plain=5 + 7 * basis, roots=3, functions=1 + basis)
    return (
        pairs * (pair + radial + rings + around) + triples * third + robots * (robot + (place if landmark else Work()))
    )


def equivariant_policy(robots: int, hidden: tuple[int, ...], basis: int, landmark: bool = True) -> tuple[Work, Work]:
    """Returns the forward pass of one configuration, and what its gradient takes beyond that."""
    nodes, edges = hidden[0], hidden[-1]
    pairs = robots**2
    node = robots * layer(robot_channels(basis, landmark), nodes)
    pair = pairs * layer(pair_channels(basis), edges)
    sides = robots * Work(products=2 * 2 * nodes * edges) + pairs * Work(plain=2 * edges)
    head = pairs * layer(edges, 2, tangent=False)
    point = robots * layer(nodes, 2, tangent=False) if landmark else Work()
    # Along and across each unit vector (6), summed (2), bounded (6, root, quotient, tangent).
    velocity = pairs * Work(plain=8) + robots * Work(plain=14, roots=2, functions=1)
    forward = features(robots, basis, landmark) + node + pair + sides + head + point + velocity
    gradient = (
        backward(node, robots * nodes, first=True)
        + backward(pair, pairs * edges, first=True)
        + backward(sides, pairs * edges / 2, first=False)
        + backward(head, pairs * 2, first=False)
        + backward(point, robots * 2, first=False)
        + pairs * Work(plain=8)
        + robots * Work(plain=40, roots=2)
    )
    return forward, gradient


def equivariant_value(robots: int, hidden: tuple[int, ...], basis: int, landmark: bool = True) -> tuple[Work, Work]:
    """Returns the forward pass of one configuration, and what its gradient takes beyond that."""
    width = hidden[0]
    node = robots * layer(robot_channels(basis, landmark), width)
    mine = robots * layer(width, width)
    ours = Work(products=2 * width**2, plain=2 * robots * width)
    head = robots * layer(width, 1, tangent=False)
    gradient = (
        backward(node, robots * width, first=True)
        + backward(mine, robots * width, first=False)
        + backward(ours, robots * width / 2, first=False)
        + backward(head, robots, first=False)
    )
    return features(robots, basis, landmark) + node + mine + ours + head, gradient


def central_network(robots: int, hidden: tuple[int, ...], out: int) -> tuple[Work, Work]:
    """Returns the forward pass of one configuration, and what its gradient takes beyond that."""
    widths = (2 * robots, *hidden)
    layers = [layer(a, b) for a, b in itertools.pairwise(widths)]
    layers.append(layer(widths[-1], out, tangent=False))
    gradients = [backward(one, one.plain, first=place == 0) for place, one in enumerate(layers)]
    return sum(layers, Work(plain=2 * robots)), sum(gradients, Work())


# The learner.

DRAW = Work(plain=70, functions=1)
"""A normal number: its random bits (about 60), which become a number (10) and go through the inverse error function."""

DENSITY = Work(plain=8)
"""A component of an action: its log density, given the mean."""

ADAM = Work(plain=14, roots=3)
"""Of a weight: norm and bound of its gradient, two moments, their corrections, root, quotient, the step itself."""


def networks(policy: PolicyConfig, robots: int) -> tuple[tuple[Work, Work], tuple[Work, Work]]:
    """Returns forward pass and gradient of the policy, and of the value."""
    if policy.kind == "central":
        actions = 1 if policy.credit == "swarm" else robots
        return central_network(robots, policy.hidden, 2 * robots), central_network(robots, policy.hidden, actions)
    numbers = (robots, policy.hidden, policy.basis)
    return equivariant_policy(*numbers), equivariant_value(*numbers)


def update(policy: PolicyConfig, ppo: PPOConfig, repeat: int, robots: int, weights: int) -> Work:
    """One whole update of all worlds: collecting, advantages, and every minibatch of every epoch.

    Args:
        policy: Which networks: equivariant or central.
        ppo: The learner's numbers.
        repeat: Steps for which each action is kept up.
        robots: Swarm size.
        weights: Weights of both networks together.
    """
    (act, act_gradient), (judge, judge_gradient) = networks(policy, robots)
    by_robot = policy.credit == "robots"
    actions = robots if by_robot else 1
    drawn = 2 * robots * (DRAW + Work(plain=3) + DENSITY)
    decision = act + drawn + repeat * step(robots, by_robot) + 2 * judge + actions * Work(plain=20)
    # Ratio, clip, the lesser objective, divergence (16, exponential), and their gradient (10); squared error (4).
    losses = actions * Work(plain=30, functions=1) + 2 * robots * (DENSITY + Work(plain=6))
    lesson = act + act_gradient + judge + judge_gradient + losses
    samples = ppo.worlds * ppo.steps
    learned = ppo.epochs * (samples * (lesson + _sample_bytes(robots, actions)) + ppo.minibatches * weights * ADAM)
    return samples * decision + learned


def _sample_bytes(robots: int, actions: int) -> Work:
    """A step to learn from is read where it was collected, dealt to a minibatch, and read by two networks."""
    return Work(bytes=FLOAT * (4 * 2 * robots + 2 * robots + 6 * actions))
