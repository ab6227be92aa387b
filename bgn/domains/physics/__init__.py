"""The force-feedback domains as MuJoCo scenes, and their compilation into exact tables.

Importing a domain's tables needs nothing of this package; it is imported where physics is stepped.
"""
