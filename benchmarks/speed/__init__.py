"""Measures how fast the project is: workloads, machine, arithmetic, comparisons and the speed report."""
