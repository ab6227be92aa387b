"""Judging what is stored: the paper's numbers, statistics, verdicts, tables, figures."""
