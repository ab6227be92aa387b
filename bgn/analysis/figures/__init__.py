"""Figures of the paper and of this project, as matplotlib figures made from evidence."""
