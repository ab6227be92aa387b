"""Simulators: one batched world for every tabular model, and the physics behind the robot domains."""
