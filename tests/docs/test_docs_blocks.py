"""Every block of every page that is written by hand, tried as a reader would: what no test can try fails."""

from __future__ import annotations

import re

import pytest
from pages import BY_HAND, DOCS, WRITTEN_BY_PROGRAMS, Reader, copy_run, tokens

SLOW = {
    "adapters.md",
    "benchmarks.md",
    "cookbook.md",
    "discovery.md",
    "formations.md",
    "problems.md",
    "start.md",
    "swarms.md",
    "world.md",
}
"""Pages whose blocks train, export and compare: the tests of these parts have the same cases."""

SHOWN = [
    pytest.param(page, marks=[pytest.mark.nightly] if page in SLOW else [])
    for page in BY_HAND
    if not page.startswith("api/")
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a finished run of the experiment that a reader of start.md writes, discovered in no time."""
    folder = tmp_path_factory.mktemp("finished")
    reader = Reader("start.md", folder)
    (text,) = [token.content for token in tokens("start.md", "fence") if token.info == "toml"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        reader.toml(text)
        reader.shell("murmurate discover my.toml --out runs/my")
    return folder


@pytest.mark.parametrize("page", SHOWN)
def test_every_block_does_what_it_says(page, finished, tmp_path, monkeypatch, capsys):
    if page != "formations.md":  # whose reader makes it
        copy_run(finished / "runs" / "my", tmp_path / "runs" / "C-formation-seed0")  # what `make discover` leaves
    if page != "start.md":  # whose reader makes both
        copy_run(finished, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # as Python has it in the folder of a reader's modules
    reader = Reader(page, tmp_path)
    reader.read()
    EXPECTED.get(page, lambda scope: None)(reader.scope)
    if reader.tried:
        capsys.readouterr()


def test_recipes_are_short():
    modules = [token.content for token in tokens("cookbook.md", "fence") if re.match(r"# \w+\.py\n", token.content)]
    assert len(modules) == 7
    assert all(len(module.splitlines()) <= 25 for module in modules)


def _adapters(scope):
    assert scope["corners"].shape == scope["positions"].shape == (4, 2)
    assert scope["observations"]["robot_0"].shape == (4, 3)


EXPECTED = {"adapters.md": _adapters}


def test_generated_pages_exist_and_are_the_only_ones_left_out():
    assert all((DOCS / page).is_file() for page in WRITTEN_BY_PROGRAMS)


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ("text\nhello", "nothing checks a block of text"),
        ("sh\ncurl x", "nothing checks `curl x`"),
        ("sh\nmake coffee", "no such target"),
        ("sh\npip install '.[coffee]'", "no such extra"),
        ("sh\nmurmurate brew", "no verb brew"),
        ("toml\n[world]\nrobots = 3", "first line"),
    ],
)
def test_what_nobody_can_try_fails(block, reason, tmp_path, monkeypatch):
    monkeypatch.setattr("pages.DOCS", tmp_path)
    (tmp_path / "page.md").write_text(f"```{block}\n```\n")
    with pytest.raises(AssertionError, match=reason):
        Reader("page.md", tmp_path).read()
