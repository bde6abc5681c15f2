"""Reports: what to train for one, the runs, a small document model, and its two renderings, HTML and Markdown.

Composes experiments and view. Nothing is imported here, so that a command line can be refused before JAX is loaded.
"""
