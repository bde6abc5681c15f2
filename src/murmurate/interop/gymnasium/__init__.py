"""Gymnasium: one agent that sets the velocities of all robots, one world at a time or many at once.

Importing this module registers `murmurate/Gathering-v0`, which `gymnasium.make` and `gymnasium.make_vec` then know.
"""

from __future__ import annotations

from murmurate.interop.extras import missing

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise missing("gymnasium") from error

from murmurate.interop.gymnasium.single import GatheringEnv
from murmurate.interop.gymnasium.vector import GatheringVectorEnv

__all__ = ["ENV_ID", "GatheringEnv", "GatheringVectorEnv", "register"]

ENV_ID = "murmurate/Gathering-v0"


def register() -> None:
    """Makes `murmurate/Gathering-v0` known to Gymnasium, unless it is already."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID, entry_point=f"{__name__}:GatheringEnv", vector_entry_point=f"{__name__}:GatheringVectorEnv"
        )


register()
