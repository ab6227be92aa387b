"""Planning with the model known: SARSOP, simpler planners, and exact optima."""
