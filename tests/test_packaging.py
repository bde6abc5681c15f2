"""What is installed and published: versions, the image, and the workflow that tests on other systems."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[1]
CONSTRAINTS = ["constraints.txt", "constraints-oldest.txt"]
UNTRIED = {"jaxmarl", "ribs", "stable-baselines3"}
"""What no test installs."""

INSTRUCTIONS = {"FROM", "WORKDIR", "COPY", "RUN", "USER", "ENTRYPOINT", "CMD"}


def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def normalized(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def pinned(constraints):
    """Returns the versions of a constraints file by name."""
    lines = (ROOT / constraints).read_text(encoding="utf-8").splitlines()
    result = [re.fullmatch(r"([\w.-]+)==(\S+)", line).groups() for line in lines if not line.startswith("#")]
    return {normalized(name): Version(version) for name, version in result}


def requirements(*extras):
    """Returns what is installed by default, and what the extras bring besides."""
    texts = [*project()["dependencies"]]
    for extra in extras:
        texts += project()["optional-dependencies"][extra]
    return [Requirement(text) for text in texts]


@pytest.mark.parametrize("constraints", CONSTRAINTS)
def test_what_is_installed_by_default_and_for_tests_is_pinned(constraints):
    versions = pinned(constraints)
    for requirement in requirements("dev"):
        assert requirement.specifier.contains(versions[normalized(requirement.name)]), requirement


def test_the_oldest_versions_are_those_that_the_project_allows():
    versions = pinned("constraints-oldest.txt")
    for requirement in requirements(*project()["optional-dependencies"]):
        (bound,) = requirement.specifier
        assert bound.operator == ">="
        oldest = versions.get(normalized(requirement.name))
        assert oldest == Version(bound.version) or (oldest is None and requirement.name in UNTRIED), requirement


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_installs_nothing_into_an_environment_that_has_what_is_needed(tmp_path):
    """The environment is a shell script, which has the packages that a file names, and notes what it ran."""
    (tmp_path / "bin").mkdir()
    python = tmp_path / "bin" / "python"
    python.write_text(PYTHON, encoding="utf-8")
    python.chmod(0o755)

    def installed(*packages):
        for name in (".core", ".dev", "log"):
            (tmp_path / name).unlink(missing_ok=True)
        (tmp_path / "packages").write_text(" ".join(packages), encoding="utf-8")
        arguments = ["make", f"VENV={tmp_path}", f"PYTHON={python}", f"{tmp_path}/.dev"]
        subprocess.run(arguments, cwd=ROOT, check=True, capture_output=True)
        log = (tmp_path / "log").read_text(encoding="utf-8").splitlines() if (tmp_path / "log").exists() else []
        subprocess.run(
            arguments, cwd=ROOT, check=True, capture_output=True
        )  # the stamps are there: nothing is to be done
        return [line.rpartition(" ")[2] for line in log if "-m venv" in line or "pip install" in line]

    assert installed("murmurate", "pytest", "sphinx") == []
    assert installed("murmurate") == [".[dev]"]
    assert installed() == [str(tmp_path), ".", ".[dev]"]


PYTHON = """#!/bin/sh
folder="$(dirname "$0")/.."
if [ "$1" = -m ]; then echo "$@" >> "$folder/log"; exit 0; fi
shift 2
for name in "$@"; do grep -qw "$name" "$folder/packages" || exit 1; done
"""


def test_each_set_of_weights_has_a_card_in_the_wheel():
    """The card says what the weights are; the page that it names, in the sources, where they were measured."""
    package = ROOT / "src" / "murmurate"
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    packed = {path for pattern in settings["package-data"]["murmurate"] for path in package.glob(pattern)}
    folders = [path.parent for path in (package / "pretrained").rglob("manifest.json")]
    assert len(folders) == 5
    for folder in folders:
        card = folder / "README.md"
        assert card in packed
        text = card.read_text(encoding="utf-8")
        assert text.startswith(f"# Weights: {folder.parent.name}, {folder.name} sensing\n")
        for part in ("**Trained:**", "**Measured:**", f'murmurate.pretrained("{folder.parent.name}", "{folder.name}")'):
            assert part in " ".join(text.split())
        (link,) = re.findall(r"\]\((.*?)\)", text)
        assert (folder / link).resolve() == ROOT / "docs" / "models.md"
        assert (ROOT / re.findall(r"`(benchmarks/.*?)`", text)[0]).is_file()


def test_the_project_says_what_it_is():
    status, *_ = [entry for entry in project()["classifiers"] if entry.startswith("Development Status :: ")]
    assert re.fullmatch(r"Development Status :: [3-6] - (Alpha|Beta|Production/Stable|Mature)", status)
    assert "Operating System :: OS Independent" in project()["classifiers"]
    assert project()["urls"]
    assert all(url.startswith("https://") for url in project()["urls"].values())
    assert (ROOT / project()["readme"]).is_file()
    assert "docs/contributing.md" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("constraints", CONSTRAINTS)
def test_constraints_are_versions_only(constraints):
    lines = (ROOT / constraints).read_text(encoding="utf-8").splitlines()
    assert lines[1:] == sorted(lines[1:], key=str.lower)
    assert not [line for line in lines if "/" in line or "@" in line]


def test_the_image_installs_what_the_constraints_say_as_a_user_without_rights():
    text = (ROOT / "Dockerfile").read_text().replace("\\\n", " ")
    steps = [line.split(maxsplit=1) for line in text.splitlines() if line and not line.startswith("#")]
    assert {name for name, _ in steps} <= INSTRUCTIONS
    for name, rest in steps:
        if name == "COPY":
            assert all((ROOT / source).exists() for source in rest.split()[:-1])
    assert any("--constraint constraints.txt" in rest for name, rest in steps if name == "RUN")
    assert [name for name, _ in steps].index("USER") < [name for name, _ in steps].index("ENTRYPOINT")
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    copied = {source for name, rest in steps if name == "COPY" for source in rest.split()[:-1]}
    assert {f"!{source}" for source in copied} <= set(ignored)


@pytest.mark.nightly
def test_the_image_is_built():
    if (
        shutil.which("docker") is None
        or subprocess.run(["docker", "info"], capture_output=True, check=False).returncode
    ):
        pytest.skip("Docker does not run here")
    subprocess.run(["docker", "build", "--tag", "murmurate-test", "."], cwd=ROOT, check=True, timeout=900)
    subprocess.run(["docker", "run", "--rm", "murmurate-test", "experiments"], check=True, timeout=120)


def test_the_workflow_runs_the_tests_on_three_systems():
    text = (ROOT / ".github/workflows/test.yml").read_text()
    assert "make ${{ matrix.target }} PYTHON=python CONSTRAINTS=${{ matrix.constraints }}" in text
    assert {*re.findall(r"(constraints[\w-]*\.txt)", text)} == {*CONSTRAINTS}
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {*re.findall(r"target: \[?(\w+)", text)} == {"test", "pytest"} <= {*targets}
    for system in ("ubuntu", "macos", "windows"):
        assert f"{system}-latest" in text
    versions = {entry.rsplit(" ", 1)[1] for entry in project()["classifiers"] if re.search(r":: 3\.\d+$", entry)}
    assert set(re.findall(r'"(3\.\d+)"', text)) == versions


def test_text_has_the_same_bytes_on_every_system():
    """The checksums of the weights that come with the package are of text files too."""
    assert "\n* text=auto eol=lf\n" in (ROOT / ".gitattributes").read_text(encoding="utf-8")
