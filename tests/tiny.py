"""An experiment that trains in a second once it is compiled, for tests of what happens around the training."""

from __future__ import annotations

from murmurate.runs import config_io, presets
from murmurate.runs.experiment import ExperimentConfig

_STAGE = {
    "horizon": 8,
    "repeat": 1,
    "learner": "ppo",
    "refine": False,
    "ppo": {"updates": 4, "worlds": 8, "steps": 4, "minibatches": 2, "epochs": 1},
}

TINY = {
    "name": "tiny",
    "objective": "C2",
    "world": {
        "robots": 3,
        "half_width": 12.0,
        "half_height": 12.0,
        "scan_radius": 40.0,
        "safe_distance": 4.0,
        "max_speed": 0.5,
    },
    "policy": {"kind": "central", "hidden": [8, 8]},
    "base": _STAGE,
    "auxiliary": _STAGE,
    "discovery": {"sigma": 8, "episodes": 8, "chunk": 2, "min_policies": 2, "max_policies": 2, "required_valid": 0.5},
    # Whatever was learned, robots that hardly learned stand still, and the swarm comes to rest at once.
    "rest": {"max_steps": 20, "switch_tolerance": 0.05, "dead_zone": 0.3, "damping": 0.0, "sidestep": 0.0},
    "shield": {"use": "none"},
}


KINDS = {
    "central": {},
    "equivariant": {"policy": {"use": "equivariant", "hidden": [8, 4]}},
    "local": {
        "policy": {"use": "local", "hidden": [8, 4]},
        "sensing": {
            "use": "visible",
            "rotation": True,
            "reflection": True,
            "unit_ratio": 2.0,
        },
    },
}
"""The kinds of tiny runs that tests share: see `tiny_run` in `conftest.py`."""


def tiny(**overlay) -> ExperimentConfig:
    """Returns the tiny experiment with some sections replaced field by field."""
    return presets.resolve("C", {"start": {"kind": "scattered"}}, TINY, overlay)


def write_toml(path, **overlay):
    """Writes the tiny experiment to a TOML file."""
    path.write_text(config_io.dump_toml(tiny(**overlay)))
    return path


def seal(folder):
    """Writes the checksums of a run's files anew after a test has changed some, as somebody who forges a run would."""
    manifest = folder.manifest()
    folder.write_manifest(manifest, len(manifest["policies"]))


def made_up_summary(episodes):
    """Returns what evaluation.json holds of episodes that a test made up, all of them valid."""
    shares = ("valid", "contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "stationary")
    steps = ("base_steps", "auxiliary_steps", "total_steps", "bound_steps")
    return {
        **dict.fromkeys(shares, 1.0),
        **dict.fromkeys(steps, 9.0),
        "auxiliary_steps": 0.0,
        "episodes": episodes,
        "starts": {"kind": "fresh"},
        "valid_interval": [0.5, 1.0],
        "signal": {},
        "failures": [],
    }
