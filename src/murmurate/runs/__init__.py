"""Experiments: presets and configuration files, the run folder, discovery from start to finish, evaluation and tables.

Nothing is imported here, so that a command line can be refused before JAX is loaded.
"""
