"""Whatever folders and files are called, the verbs print text in which a terminal acts on nothing."""

from __future__ import annotations

import shutil

import pytest

from murmurate.cli.main import main
from murmurate.terminal import say, say_text

NASTY = "x\x1b]0;title\x07[b]\nvalid"
ESCAPED = "x\\x1b]0;title\\x07[b]\\nvalid"


@pytest.fixture
def nasty(tiny_run, tmp_path, monkeypatch):
    """The name of a finished run in the working folder; this file system may not have such names."""
    monkeypatch.chdir(tmp_path)
    try:
        shutil.copytree(tiny_run(), tmp_path / NASTY)
    except OSError:
        pytest.skip("this file system refuses control characters in names")
    return NASTY


@pytest.mark.parametrize(
    "words",
    [
        ["show", "RUN", "COPY", "--out", "OUT"],
        ["evaluate", "RUN", "--episodes", "2", "--quiet"],
        ["evaluate", "RUN", "--episodes", "2", "--out", "OUT"],
        ["catalogue", "RUN", "--out", "OUT"],
        ["table", "RUN", "COPY"],
        ["export", "RUN", "--trajectories", "csv"],
        ["starts", "cluster", "--robots", "3", "--count", "1", "--out", "OUT"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_no_name_reaches_the_terminal_raw(nasty, tmp_path, capsys, words):
    shutil.copytree(nasty, tmp_path / "copy")
    names = {"RUN": nasty, "COPY": "copy", "OUT": f"{NASTY}-out"}
    status = main([names.get(word, word) for word in words])
    out, err = capsys.readouterr()
    assert status == 0, err
    assert "\x1b" not in out + err
    assert "\x07" not in out + err
    # A line break in a name begins no line of its own, which could say anything.
    assert not any(line.startswith("valid") and "title" not in line for line in out.splitlines() if "|" not in line)
    assert "x1b]0;title" in out or r"x1b\]0;title" in out  # in Markdown, as `table` prints it
    if words[0] == "export":  # what is named after the run
        assert (tmp_path / f"{ESCAPED}.csv").is_file()


def test_lines_are_printed_as_they_are_but_for_what_a_terminal_acts_on(capsys):
    say(NASTY)
    say("  two  spaces, é, \U0001f600, \udcff \x9b31m\u202e")
    say()
    say_text("a\tb\nc\x1b\n\n")
    harmless = f"{ESCAPED}\n  two  spaces, é, \U0001f600, \\udcff \\x9b31m\\u202e\n"
    assert capsys.readouterr().out == f"{harmless}\na\\tb\nc\\x1b\n\n"
