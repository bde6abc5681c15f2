"""Reports of reproductions: which runs one needs, their numbers, and the page, as Markdown and as HTML.

Nothing is imported here, so that a command line can be refused before JAX is loaded.
"""
