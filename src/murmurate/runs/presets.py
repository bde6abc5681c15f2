"""Ready-made experiments: the paper's six, with the numbers of each learner, which live here and nowhere else."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from murmurate.discovery import DiscoveryConfig, RestRule, StageConfig
from murmurate.discovery.problem import GATHERING, GATHERING_SIGNALS
from murmurate.errors import InputError, check_choice
from murmurate.learning import GradientConfig, PPOConfig
from murmurate.policies import (
    CentralPolicy,
    ClearanceShield,
    EquivariantPolicy,
    FormationPolicy,
    LocalPolicy,
    NoShield,
    Policy,
    Shield,
)
from murmurate.runs import config_io
from murmurate.runs.experiment import ExperimentConfig, make_importer, read_toml
from murmurate.runs.paper import EXPERIMENTS, NOISE, PaperExperiment, check_experiment
from murmurate.runs.problems import PROBLEMS, problem_file
from murmurate.world import OBJECTIVES, ScatteredStart, Start, WorldConfig

__all__ = [
    "DEFAULT_LEARNER",
    "GENERAL_LEARNER",
    "TRAINING_PRESETS",
    "TrainingPreset",
    "command",
    "paper_row",
    "preset",
    "resolve",
]


@dataclass(frozen=True)
class TrainingPreset:
    """How policies are represented, trained and executed: all of an experiment that is not the problem itself.

    Attributes:
        policy: Which networks.
        base: How the base policy is trained.
        auxiliary: How each auxiliary policy is trained.
        discovery: How the list of policies grows.
        rest: When a policy has come to rest.
        shield: What shortens the robots' moves.
    """

    policy: Policy
    base: StageConfig
    auxiliary: StageConfig
    discovery: DiscoveryConfig = field(default_factory=DiscoveryConfig)
    rest: RestRule = field(default_factory=RestRule)
    shield: Shield = field(default_factory=NoShield)


# PPO finds the way, gradients make it short: alone, the first settles slowly and wide, and the second never frees a
# robot inside the ring. Robots come to rest about as much beyond the safe distance as the margins say. Motion costs a
# little in either phase, because otherwise a ring may turn for ever: no signal changes, and its robots never come to
# rest. It costs more here, where every step costs what it lacks to the best pattern; with a tenth, patterns creep.
# Without `occluders`, two groups that meet (F) keep dents, in which robots hide each other.
_REFINEMENT = GradientConfig(
    average=100,
    weights={"gathering": 1.0, "smooth_safety": 20.0, "smooth_visible": 10.0, "exposed": 2.0, "occluders": 10.0},
    margins={"smooth_safety": 0.02, "smooth_visible": 0.02},
    motion_cost=0.3,
)

# Each action is kept up for some steps while PPO learns: exploration then moves robots instead of jittering them,
# without which most searches end with a robot stuck inside the ring (try --policy equivariant --base.repeat 1). And
# exploration fades: left to itself it stays, because noise frees a stuck robot, and the policy never learns to do so
# without it (try --base.ppo.exploration learned).
_EQUIVARIANT = TrainingPreset(
    policy=EquivariantPolicy(hidden=(32, 16), whole_square=True),
    base=StageConfig(
        ppo=PPOConfig(updates=60, policy_rate=2e-3, exploration="scheduled", log_std=-1.0, log_std_end=-2.5),
        weights={"gathering": 3.0, "visible": 2.0},
        refine=True,
        gradients=_REFINEMENT,
        horizon=100,
        repeat=4,
        motion_cost=0.02,
    ),
    auxiliary=StageConfig(
        ppo=PPOConfig(updates=60, exploration="scheduled", log_std=-0.7, log_std_end=-3.5),
        weights={"gathering": 2.0, "safety": 3.0, "neighbors": 2.0, "visible": 4.0},
        learner="gradients",
        gradients=_REFINEMENT,
        horizon=100,
        repeat=2,
        motion_cost=0.03,
        warm_start=True,
    ),
    discovery=DiscoveryConfig(min_policies=1, max_policies=2),
    rest=RestRule(dead_zone=0.15, damping=0.2, sidestep=1.0),
    shield=ClearanceShield(),
)

# The paper's method, with measured numbers. What serves the other learner (fading exploration, credit robot by robot,
# longer repeats) makes this one erratic: some seeds gain, others lose every pattern. Without `convex`, robots that
# closeness led inside the ring stay there (C): to leave, they would have to pass between two others, which costs safety
# more than visibility pays. The auxiliary policies open the ring first: with gathering 1.5 and convex 3, one of ten
# seeds never freed the last robot of C, and four needed two or three policies more. The shield does not serve it:
# robots that are trained behind it crowd, and where it shortens moves of a policy that was trained without it, the
# pattern breaks. Margins keep robots from touching instead. Without a cost of motion, a policy may swing for ever as
# soon as it acts without noise (D with seed 2, A with seed 4); with one of 0.02, which is more than a step towards the
# origin pays in A, robots do not gather.
_CENTRAL = TrainingPreset(
    policy=CentralPolicy(hidden=(128, 128), credit="swarm"),
    base=StageConfig(
        ppo=PPOConfig(updates=150, epochs=4),
        weights={"gathering": 2.0, "safety": 0.3, "neighbors": 1.0, "visible": 4.0, "convex": 3.0},
        horizon=200,
        repeat=2,
        random_share=0.0,
        motion_cost=0.002,
        margin=0.1,
    ),
    auxiliary=StageConfig(
        ppo=PPOConfig(updates=150, epochs=4, discount=0.90),
        weights={"gathering": 0.5, "safety": 0.5, "neighbors": 2.0, "visible": 6.0, "convex": 10.0},
        horizon=60,
        motion_cost=0.002,
        margin=0.05,
    ),
    discovery=DiscoveryConfig(max_policies=4),
)

# As the paper has it where it says, and as its authors' published set-up where it does not: the clip range rises (by
# how much, neither says), the value target is the undiscounted rewards-to-go, every episode begins at the start.
_PAPER_PPO: dict[str, Any] = {
    "updates": 120,
    "worlds": 256,
    "steps": 64,
    "policy_rate": 4.5e-4,
    "policy_rate_end": 1.5e-4,
    "value_rate": 4.5e-4,
    "value_rate_end": 1.5e-4,
    "clip": 0.1,
    "clip_end": 0.3,
    "value_target": "rewards-to-go",
    "reward_scale": 1.0,
}
_PAPER = TrainingPreset(
    policy=CentralPolicy(hidden=(400, 300, 300), credit="swarm"),
    base=StageConfig(ppo=PPOConfig(**_PAPER_PPO, discount=0.95, gae_lambda=0.95), horizon=800, random_share=0.0),
    auxiliary=StageConfig(ppo=PPOConfig(**_PAPER_PPO, discount=0.85, gae_lambda=0.99), horizon=400, noise=0.0),
    discovery=DiscoveryConfig(max_policies=2),
    rest=RestRule(max_steps=800),
)

_LOCAL = replace(_EQUIVARIANT, policy=LocalPolicy(hidden=(32, 16)))

# The formation is searched first, by what it is worth; then gradients teach robots the way into it.
_FORMATION = TrainingPreset(
    policy=FormationPolicy(),
    base=StageConfig(learner="goals", refine=True, gradients=GradientConfig(updates=300), hard_share=0.3, horizon=100),
    auxiliary=StageConfig(learner="gradients", warm_start=True),
    discovery=DiscoveryConfig(min_policies=1, max_policies=1, chunk=50),
    rest=RestRule(dead_zone=1e-4),
    shield=ClearanceShield(),
)

TRAINING_PRESETS = {
    "formation": _FORMATION,
    "equivariant": _EQUIVARIANT,
    "central": _CENTRAL,
    "local": _LOCAL,
    "paper": _PAPER,
}
"""Learners by name: one for each kind of policy, and the paper's own numbers."""

DEFAULT_LEARNER = "formation"
"""Whose numbers the paper's experiments have, unless said otherwise."""

GENERAL_LEARNER = "equivariant"
"""The same of all other problems: it takes swarms of several sizes, and signals that have no gradient."""


def preset(name: str, learner: str = DEFAULT_LEARNER, objective: str | None = None) -> ExperimentConfig:
    """Returns one of the paper's experiments.

    Args:
        name: A to F.
        learner: The training preset: formation, equivariant, central, local or paper.
        objective: An objective to use instead of the experiment's own.

    Raises:
        InputError: There is no such experiment, training preset or objective.
    """
    check_choice("experiment", name, tuple(EXPERIMENTS))
    row = EXPERIMENTS[name]
    start = cast(Start, Start.registered()[row.start](noise=NOISE))  # type: ignore[call-arg]
    return _experiment(name, objective or row.objective, row.world, start, learner)


def resolve(
    experiment: str | Path | ExperimentConfig,
    *overlays: Mapping[str, Any],
    learner: str | None = None,
    default: str | None = None,
    folders: Sequence[Path] = (),
) -> ExperimentConfig:
    """Puts an experiment together.

    Args:
        experiment: A to F, a problem of the package ("circle"; see `murmurate experiments`), a TOML file whose fields
            replace those of a scattered ten-robot experiment, or a configuration.
        *overlays: Fields to replace, as nested dictionaries; later ones win.
        learner: The training preset; by default that of the policy. A policy of one's own has that of equivariant.
        default: The training preset where neither one nor a policy is named; by default formation for A to F, and
            equivariant for a file and for what formation does not serve: signals of one's own and several swarm sizes.
        folders: Folders in which modules of "module:Class" are looked for, after that of the TOML file.

    Raises:
        InputError: An experiment, field or value is unknown or not allowed.
        OSError: A file cannot be read.
    """
    if isinstance(experiment, ExperimentConfig):
        importer = replace(make_importer({"modules": experiment.modules}), folders=tuple(folders))
        config = config_io.replaced(experiment, config_io.merged({}, *overlays), importer=importer)
        _check_used(config, experiment)
        return config
    check_experiment(str(experiment))
    named = str(experiment) in EXPERIMENTS
    experiment = problem_file(str(experiment)) if experiment in PROBLEMS else experiment
    data = config_io.merged({} if named else read_toml(experiment), *overlays)
    importer = make_importer(data, None if named else Path(experiment).parent)
    importer = replace(importer, folders=(*importer.folders, *folders))
    chosen = learner or _learner_name(data, named, default)
    objective = data.get("objective")
    if objective is not None:
        check_choice("objective", objective, tuple(OBJECTIVES))
    # The preset has the experiment's own objective where the user has signals alone: without any, it would be refused.
    given = None if objective == "custom" else objective
    if named:
        base = preset(str(experiment), chosen, given)
    else:
        data.setdefault("name", Path(experiment).stem)
        base = _experiment("unnamed", given or "C1", WorldConfig(), ScatteredStart(), chosen)
    if data.get("signals"):
        base = _unrefined(base)
    if objective == "custom":
        base = _weighing(base, data.get("signals"))
    config = config_io.replaced(base, data, importer=importer)
    if named:  # a file may hold the numbers of every learner, whichever policy it is used with
        _check_used(config, base)
    return config


def command(config: ExperimentConfig) -> str:
    """Returns the command that discovers an experiment: a flag for each field that is not as in the paper's experiment.

    An experiment that is none of the paper's is a problem of the package, or in a file of its name.
    """
    if config.name not in EXPERIMENTS:
        source = config.name if config.name in PROBLEMS else f"{config.name}.toml"
        return shlex.join(["murmurate", "discover", source, "--seed", str(config.seed)])
    policy = config.policy.name
    arguments = ["murmurate", "discover", config.name, "--seed", str(config.seed)]
    problem = {"signals": config.signals, "sizes": config.sizes}
    arguments += ["--policy", policy] if policy != _learner_name(problem, named=True) else []
    learner = _learner_name({"policy": policy}, named=True)
    defaults = {leaf.path: leaf.value for leaf in config_io.leaves(preset(config.name, learner))}
    for leaf in config_io.leaves(config):
        is_given = leaf.path in ("seed", "policy.use") or leaf.path.startswith("modules.")
        if not is_given and leaf.value != defaults.get(leaf.path):
            arguments += [f"--{leaf.path}", config_io.spelled(leaf.value)]
    return shlex.join(arguments)


def paper_row(config: ExperimentConfig) -> PaperExperiment | None:
    """Returns the experiment of the paper that has this world, objective and start; None when there is none."""
    if not config.has_paper_objective:
        return None
    for name, row in EXPERIMENTS.items():
        paper = preset(name)
        if (config.world, config.objective, config.start) == (paper.world, paper.objective, paper.start):
            return row
    return None


def _experiment(name: str, objective: Any, world: WorldConfig, start: Start, learner: str) -> ExperimentConfig:
    check_choice("learner", learner, tuple(TRAINING_PRESETS))
    numbers = TRAINING_PRESETS[learner]
    return ExperimentConfig(
        name=name,
        objective=objective,
        world=world,
        start=start,
        policy=numbers.policy,
        base=numbers.base,
        auxiliary=numbers.auxiliary,
        discovery=numbers.discovery,
        rest=numbers.rest,
        shield=numbers.shield,
        seed=0,
    )


def _unrefined(config: ExperimentConfig) -> ExperimentConfig:
    """Returns a preset without refinement by gradients, which would know nothing of signals of one's own."""
    # What refines a policy that has goals is how near it comes to them, whatever they are made of.
    if not config.base.refine or config.policy.has_goals:
        return config
    base, auxiliary = replace(config.base, refine=False), replace(config.auxiliary, learner="ppo")
    discovery = replace(config.discovery, min_policies=2, max_policies=3)
    return replace(config, base=base, auxiliary=auxiliary, discovery=discovery)


def _weighing(config: ExperimentConfig, signals: Any) -> ExperimentConfig:
    """Returns a preset without its weights of signals that an objective of the user's signals alone does not have."""
    names = set(signals) if isinstance(signals, Mapping) else set()
    names |= {GATHERING} if names & set(GATHERING_SIGNALS) else set()

    def kept(stage: StageConfig) -> StageConfig:
        stage = replace(stage, weights={name: weight for name, weight in stage.weights.items() if name in names})
        if not config.policy.has_goals:
            return stage
        searched = {name: weight for name, weight in stage.goals.weights.items() if name in (*names, "smooth_safety")}
        margins = {name: margin for name, margin in stage.goals.margins.items() if name in searched}
        return replace(stage, goals=replace(stage.goals, weights=searched, margins=margins))

    return replace(config, base=kept(config.base), auxiliary=kept(config.auxiliary))


def _check_used(config: ExperimentConfig, usual: ExperimentConfig) -> None:
    """Refuses numbers that no learner of the preset reads, rather than train without them.

    Who names a learner as well may keep the numbers of another: a file that refines a run goes over the run's own.
    """
    before = {leaf.path: leaf.value for leaf in config_io.leaves(usual)}
    for leaf in config_io.leaves(config):
        section, _, name = leaf.path.partition(".")
        if section not in ("base", "auxiliary") or leaf.value == before.get(leaf.path):
            continue
        stage = getattr(config, section)
        if stage.learner == getattr(usual, section).learner and name.partition(".")[0] in stage.unread:
            trained = " and ".join(stage.learners)
            raise InputError(leaf.path, leaf.value, f"left out: {section} is trained by {trained} here, without it")


def _learner_name(data: Mapping[str, Any], named: bool, default: str | None = None) -> str:
    """Returns the training preset of the policy that is asked for, or else the usual one of such a problem."""
    policy = data.get("policy")
    if isinstance(policy, Mapping):
        policy = policy.get(config_io.USE, policy.get(config_io.OLD_USE))
    use = policy.name if isinstance(policy, Policy) else policy
    if use is not None:
        known = isinstance(use, str) and use in TRAINING_PRESETS and use != "paper"
        return use if known else GENERAL_LEARNER
    is_usual = named and not data.get("signals") and not data.get("sizes")
    return default or (DEFAULT_LEARNER if is_usual else GENERAL_LEARNER)
