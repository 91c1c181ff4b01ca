"""Verbs that need the simulation: a module each, or a package of sub-verbs.

pyproject.toml lists them.
"""
