"""The benchmark: its registry, and the command that runs it."""
