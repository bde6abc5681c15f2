"""The figures of the page about the world come from the library's own geometry, and look as they are shown."""

from __future__ import annotations

import runpy

import numpy as np
import pytest
from pages import DOCS
from PIL import Image

SHOWN = DOCS / "figures" / "world"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The folder that docs/draw.py draws into."""
    folder = tmp_path_factory.mktemp("drawn")
    runpy.run_path(str(DOCS / "draw.py"))["main"]([str(folder)])
    return folder


def test_every_figure_is_drawn_again(drawn):
    assert {path.name for path in drawn.iterdir()} == {path.name for path in SHOWN.iterdir()}
    page = (DOCS / "world.md").read_text("utf-8")
    for path in SHOWN.iterdir():
        assert f"(figures/world/{path.name})" in page
        old, new = (np.asarray(Image.open(folder / path.name).convert("L"), float) for folder in (SHOWN, drawn))
        assert old.shape == new.shape
        assert abs(old - new).mean() < 1  # of 255: other fonts or another Matplotlib, not another picture


def test_figures_are_small():
    assert sum(path.stat().st_size for path in SHOWN.iterdir()) < 300_000
