"""The page about the adapters: its examples run one after another, as a reader would try them."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "adapters.md"


def test_every_example_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 4
    scope = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), scope)
    assert scope["corners"].shape == scope["positions"].shape == (4, 2)
    assert scope["observations"]["robot_0"].shape == (4, 3)
    assert capsys.readouterr().out
