"""How Sphinx builds these pages: `make docs`, with warnings as errors; `tests/docs` builds and checks them too."""

from __future__ import annotations

import re
import typing
from typing import Any

from sphinx.application import Sphinx

import murmurate

# jaxtyping's own switch, before anything loads it: array types keep the names that annotations give them.
typing.GENERATING_DOCUMENTATION = "murmurate"

project = "murmurate"
release = version = murmurate.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["comparison/**.md"]  # `make compare` puts what they say into results.md and point.md

# Formulas: `$...$` and `$$...$$`, as Markdown viewers have them. MathJax comes with a package, copied into the site.
myst_enable_extensions = ["dollarmath", "amsmath"]

# Headings get the anchors that Markdown viewers give them, so that one link serves both.
myst_heading_anchors = 4

# Furo's pages hold text and navigation in the HTML itself, so they read well without JavaScript, and load nothing from
# elsewhere.
html_theme = "furo"
html_title = "murmurate"
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["pages.css"]

autodoc_default_options = {"members": True, "imported-members": True, "member-order": "bysource"}
default_role = "code"  # single backticks in our docstrings mean code, as in Markdown
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False  # types stand in the signature already

nitpick_ignore_regex = [
    # Type variables and aliases of types.
    ("py:.*", r"murmurate\.(discovery\.problem\.ProblemT|learning\.sharding\.Result|registry\.S)"),
    ("py:.*", r"Credit|Freedom|Key|Safety"),
    ("py:.*", r"eqx\.AbstractVar"),
    # Names of other packages: to know where they are explained, Sphinx would have to fetch their inventories.
    ("py:.*", r"(collections|gymnasium|jax|jaxlib|jaxtyping|matplotlib|numpy|os|pathlib|pettingzoo)\..*"),
    # The same names where an annotation is shown as it is written.
    ("py:.*", r"Array|Bool|Float|Int|PRNGKeyArray|UInt8|UInt32|Path|ResetNeeded|(?:np\.)?ndarray"),
]

# Several classes are called Policy or Transition; a reference that fits more than one leads to the first.
suppress_warnings = ["ref.python"]

_PROSE = ("attribute", "data", "property")
_LETTERS = re.compile(r"[*|]")


def _read_docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Puts a docstring into Napoleon's terms: stars and bars are themselves, and types stand in annotations only."""
    prose = what in _PROSE
    for index, line in enumerate(lines):
        parts = line.split("`")
        parts[::2] = [_LETTERS.sub(r"\\\g<0>", part) for part in parts[::2]]
        text = "`".join(parts)
        # What precedes the first colon would be read as a type; a colon in front says that there is none.
        lines[index] = re.sub(r"\S", r": \g<0>", text, count=1) if prose else text
        prose = line.strip() in ("Returns:", "Yields:")


def _read_signature(app: Sphinx, *about: Any) -> tuple[str | None, ...]:
    """Shows a default made anew each time as an ellipsis, not as `<factory>`, and arrays as arrays."""
    # To a type checker the geometry's arrays, NumPy's or JAX's, are anything.
    return tuple(text and text.replace("<factory>", "...").replace("[Any, '", "[Array, '") for text in about[-2:])


def setup(app: Sphinx) -> None:
    """Connects what this project's docstrings and signatures need."""
    app.connect("autodoc-process-docstring", _read_docstring, priority=400)  # before Napoleon
    app.connect("autodoc-process-signature", _read_signature)
