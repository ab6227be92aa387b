"""Makes the domains known to Gymnasium; builds and imports nothing until one is asked for."""

from __future__ import annotations

import gymnasium

#: Gymnasium's id, and the id in ``bgn.domains``, of the domains that are played on their tables.
TABLE_ENVIRONMENTS = {
    "bgn/Hallway-v0": "hallway",
    "bgn/Hallway2-v0": "hallway-2",
    "bgn/RockSample44-v0": "rocksample-4-4",
    "bgn/RockSample55-v0": "rocksample-5-5",
}
#: Those that are stepped in MuJoCo; they cut episodes themselves, at the limit of their variant.
PHYSICS_ENVIRONMENTS = {
    "bgn/TopPlate-v0": "top-plate",
    "bgn/TwoBumps1D-v0": "two-bumps-1d",
    "bgn/TwoBumps2D-v0": "two-bumps-2d",
}
STEP_LIMIT = 100  # paper, Table 5


def register() -> None:
    """Register every environment of this package."""
    for environment_id, domain_id in TABLE_ENVIRONMENTS.items():
        gymnasium.register(
            environment_id,
            entry_point="bgn.environments.tabular:TableEnvironment",
            max_episode_steps=STEP_LIMIT,
            kwargs={"domain_id": domain_id},
        )
    for environment_id, domain_id in PHYSICS_ENVIRONMENTS.items():
        gymnasium.register(
            environment_id,
            entry_point="bgn.environments.physics:PhysicsEnvironment",
            kwargs={"domain_id": domain_id},
        )
