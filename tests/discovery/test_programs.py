"""Compiled programs are forgotten before the process can map no more, and only then."""

from __future__ import annotations

import jax
import pytest

from murmurate.discovery import Search, programs
from tiny import tiny


@pytest.mark.parametrize(("mapped", "most", "times"), [(69, "100\n", 0), (71, "100\n", 1), (9, "unlimited", 0)])
def test_programs_are_forgotten_near_the_limit(mapped, most, times, tmp_path, monkeypatch):
    cleared = []
    monkeypatch.setattr(jax, "clear_caches", lambda: cleared.append(True))
    for name, text in (("MAPS", "a piece\n" * mapped), ("MOST_MAPS", most)):
        (tmp_path / name).write_text(text, encoding="ascii")
        monkeypatch.setattr(programs, name, tmp_path / name)
    programs.forget_programs()
    assert len(cleared) == times


def test_where_nothing_is_counted_programs_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "MAPS", tmp_path / "missing")
    monkeypatch.setattr(jax, "clear_caches", lambda: pytest.fail("programs were forgotten"))
    programs.forget_programs()


def test_every_chunk_begins_with_it(monkeypatch):
    calls, config = [], tiny()
    monkeypatch.setattr("murmurate.discovery.search.forget_programs", lambda: calls.append(True))
    search = Search(config)
    search.advance(search.begin())
    assert calls
