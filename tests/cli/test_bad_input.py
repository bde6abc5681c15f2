"""Bad input is one line on stderr and exit status 2; nothing is written, and no run is damaged."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest

from murmurate.cli.main import main

EXPERIMENTS = (
    "A, B, C, D, E, F, arrow, chain, circle, convex, groups, line, spread, surround, visibility, or a TOML file"
)
START = "start,x,y\n0,-5,0\n0,0,0\n0,5,0\n"


@pytest.fixture
def refused(tmp_path, capsys, monkeypatch):
    """Runs a command in an empty folder, checks that it is refused, and returns its line."""

    def run(*arguments, files=0):
        capsys.readouterr()
        assert main([str(word) for word in arguments]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("murmurate: ")
        assert err.count("\n") == 1
        assert "Traceback" not in err
        assert len(list(tmp_path.iterdir())) == files
        return err.removeprefix("murmurate: ").strip()

    monkeypatch.chdir(tmp_path)
    return run


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("discover", "the following arguments are required: EXPERIMENT"),
        ("discover G", f"experiment = 'G': must be one of {EXPERIMENTS}"),
        ("discover --seed 1 G", "experiment = 'G': must be one of"),
        ("discover c", "or a TOML file; did you mean C?"),
        ("discover missing.toml", "experiment = 'missing.toml': must be an existing TOML file: no such file"),
        ("optimum missing.toml", "experiment = 'missing.toml': must be an existing TOML file: no such file"),
        ("experiments missing.toml", "experiment = 'missing.toml': must be an existing TOML file: no such file"),
        ("discover C --config missing.toml", "missing.toml: No such file or directory"),
        ("discover C --seeed 1", "unknown flag --seeed; did you mean --seed"),
        ("discover C --world.radus 1", "unknown flag --world.radus; did you mean --world.radius?"),
        ("discover C --policy centrl", "policy.use = 'centrl': must be one of central, equivariant"),
        ("discover C --learner best", "learner = 'best': must be one of formation, equivariant, central, local, paper"),
        ("discover C --objective C3", "objective = 'C3': must be one of C1, C2"),
        ("discover C --seed -1", "seed = -1: must be an integer from 0 to"),
        ("discover C --seed 1.5", "seed = '1.5': must be an integer"),
        ("discover C --world.robots 1", "world.robots = 1: must be an integer >= 2"),
        ("discover C --world.robots -3", "world.robots = -3: must be an integer >= 2"),
        ("discover C --world.radius -1", "world.radius = -1.0: must be a finite number > 0"),
        ("discover C --world.radius nan", "world.radius = nan: must be a finite number > 0"),
        ("discover C --world.max_speed inf", "world.max_speed = inf: must be a finite number > 0"),
        ("discover C --world.half_width -inf", "world.half_width = -inf: must be a finite number > 0"),
        ("discover C --base.weights.visible -1", "base.weights.visible = -1.0: must be a finite number >= 0"),
        ("discover C --auxiliary.weights.safety nan", "auxiliary.weights.safety = nan: must be a finite number >= 0"),
        ("discover C --base.horizon 99999999999", "base.horizon = 99999999999: must be an integer >= 1 and <="),
        ("discover C --rest.max_steps 99999999999", "rest.max_steps = 99999999999: must be an integer >= 1 and <="),
        ("discover C --base.ppo.log_std 1e300", "base.ppo.log_std = 1e+300: must be a finite number >= -20 and <= 20"),
        (
            "discover C --world.collision_penalty 1e300",
            "world.collision_penalty = 1e+300: must be a finite number >= 0",
        ),
        ("discover C --policy.credit team", "policy.credit = 'team': must be one of robots, swarm"),
        ("discover C --policy.hidden 8,8,8", "policy.hidden = (8, 8, 8): must be one or two integers >= 1"),
        ("discover C --base.ppo.exploration no", "base.ppo.exploration = 'no': must be one of learned, scheduled"),
        ("discover C --world.robots 1000", "world.robots = 1000: must be few enough to fit the distributed start"),
        ("discover C --start.use file --start.file no.csv", "starts = 'no.csv': must be a readable CSV file"),
        ("evaluate", "the following arguments are required: RUN"),
        ("evaluate none", "none holds no run"),
        ("evaluate none --episodes 0", "episodes = 0: must be an integer >= 1 and <= 10000"),
        ("evaluate none --episodes many", "--episodes = 'many': must be an integer"),
        ("discover C --from none", "none holds no run"),
        ("discover C --from none --seeds 2", "none holds no run"),
        ("evaluate none --seed -1", "seed = -1: must be an integer from 0 to"),
        ("show none", "none holds no run"),
        ("show none none", "of several runs, only the patterns are drawn"),
        ("table none", "none holds no run"),
        ("discover C --policy.hidden 32x16", "policy.hidden = '32x16': must be integers, separated by commas, such as"),
        ("discover C --world.radius 1,2", "world.radius = '1,2': must be a number without commas, such as 1.2"),
        ("discover C --sensing.rotation", "--sensing.rotation needs a value, such as --sensing.rotation true"),
        ("discover C --world.half_width 4", "or make world.half_width = 4 or world.half_height = 45 larger"),
        ("discover C --world.half_width 4 --start.use symmetric --policy local", "or make world.half_width = 4 or"),
        (
            "discover C --world.max_speed 500",
            "world.max_speed = 500.0: must be at most 90, the longer side of the world: no step inside it is longer",
        ),
        (
            "experiments G",
            f"experiment = 'G': must be one of {EXPERIMENTS}",
        ),
        ("experiments --learner best", "--learner is for one experiment: give its name"),
        ("experiments A --learner best", "learner = 'best': must be one of"),
        ("compare --workers 0", "--workers = 0: must be an integer >= 1"),
        ("reproduce --workers 0", "--workers = 0: must be an integer >= 1"),
    ],
)
def test_bad_words(refused, arguments, line):
    assert line in refused(*arguments.split())


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[world\n", "configuration file = 'my.toml': must be valid TOML"),
        ("[world]\nradus = 1.0\n", "world.radus = 1.0: must be a field of [world]"),
        ("[wrld]\nradius = 1.0\n", "did you mean world?"),
        ('[world]\nradius = "big"\n', "world.radius = 'big': must be a number"),
        ("[world]\nradius = nan\n", "world.radius = nan: must be a finite number > 0"),
        ("world = 3\n", "world = 3: must be a table"),
        ('[policy]\nkind = "paper"\n', "policy.use = 'paper': must be one of"),
        ('name = "../up"\n', "name = '../up': must be up to 64 letters"),
    ],
)
def test_bad_experiment_files(refused, tmp_path, text, line):
    (tmp_path / "my.toml").write_text(text)
    assert line in refused("discover", "my.toml", files=1)
    assert line in refused("discover", "C", "--config", "my.toml", files=1)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (START.replace("0,5,0\n", ""), "mine.csv: start 0 = '2 robots': must be 3 robots"),
        (START + "0,9,0\n", "mine.csv: start 0 = '4 robots': must be 3 robots"),
        (START.replace("start,x,y", "start,x,z"), "must be a table with the header start,x,y"),
        (START.replace("-5", "left"), "mine.csv line 2: x = 'left': must be a finite number"),
        (START.replace("-5", "-5_0"), "mine.csv line 2: x = '-5_0': must be a finite number"),
        (START.replace("-5", "nan"), "mine.csv line 2: x = 'nan': must be a finite number"),
        (START + "0,-10,5,3,25\n", "mine.csv line 5: row = '0,-10,5,3,25': must be of 3 cells, as the header is"),
        (
            START.replace("start,x,y", "start,x,x,y"),
            "line 1: header = 'start,x,x,y': must be without a second column x",
        ),
        (START.replace("start,x,y", "start,x,y,start"), "must be without a second column start"),
        (START.replace("\n0,", "\n7,").replace("-5", "-50"), "mine.csv: start 7 = 'a robot outside'"),
        (START.replace("\n0,", "\n7,").replace("-5", "-1.5"), "mine.csv: start 7 = 'overlapping robots'"),
        (START.replace("-5", "-1.5"), "mine.csv: start 0 = 'overlapping robots'"),
        (START.replace("-5", "-50"), "mine.csv: start 0 = 'a robot outside'"),
        ("start,x,y\n", "must be at least one start"),
        ("", "must be a table with the header start,x,y"),
        ("\0\1\2", "mine.csv"),
    ],
)
def test_bad_files_of_starts(refused, discovered, tiny_toml, tmp_path, text, line):
    (tmp_path / "mine.csv").write_text(text)
    before = contents(discovered)
    assert line in refused("evaluate", discovered, "--starts", "mine.csv", files=1)
    assert contents(discovered) == before
    assert line in refused("discover", tiny_toml, "--start.use", "file", "--start.file", "mine.csv", files=1)


@pytest.mark.parametrize("options", [(), ("--backend", "ray"), ("--backend", "slurm")])
def test_a_sweep_without_workers(refused, tmp_path, options):
    (tmp_path / "sweep.toml").write_text('experiments = ["C"]\n')
    line = refused("sweep", "sweep.toml", "--workers", "0", *options, files=1)
    assert line.startswith("--workers = 0: must be an integer >= 1")


def test_an_experiment_is_a_name_or_a_toml_file(refused, tmp_path):
    (tmp_path / "mine").write_text("")
    line = refused("discover", "mine", files=1)
    assert line.startswith("experiment = 'mine': must be one of A, B, C, D, E, F, arrow, ")
    assert line.rstrip().endswith(", or a TOML file, whose name ends in .toml")
    (tmp_path / "dir.toml").mkdir()
    assert "must be an existing TOML file: it is a folder" in refused("discover", "dir.toml", files=2)


def test_more_episodes_than_a_file_of_starts_has(refused, discovered, tmp_path):
    (tmp_path / "mine.csv").write_text(START)
    line = refused("evaluate", discovered, "--starts", "mine.csv", "--episodes", "2", files=1)
    assert "episodes = 2: must be at most the 1 starts of mine.csv" in line


def test_a_file_of_starts_that_is_missing_or_no_text(refused, discovered, tmp_path):
    assert "must be a readable CSV file" in refused("evaluate", discovered, "--starts", "no.csv")
    (tmp_path / "mine.csv").write_bytes(b"\xff\xfe\x00")
    assert "must be a readable CSV file (it is not text)" in refused(
        "evaluate", discovered, "--starts", "mine.csv", files=1
    )


def test_a_name_of_starts_that_is_misspelled(refused, discovered):
    line = refused("evaluate", discovered, "--starts", "clusters")
    assert "starts = 'clusters': must be one of random, polygon, line, " in line
    assert "or a CSV file; did you mean cluster?" in line


def test_starts_that_need_more_robots(refused, discovered):
    assert "robots = 3: must be at least 4 for the start rings" in refused("evaluate", discovered, "--starts", "rings")


def test_sets_of_starts_that_there_are_not(refused, tmp_path):
    assert "family = 'hard': must be one of random, cluster, corner, wall" in refused("starts", "hard")
    assert "robots = 1: must be an integer" in refused("starts", "cluster", "--robots", "1")
    assert "robots = 3: must be at least 4 for the start rings" in refused("starts", "rings", "--robots", "3")
    assert "count = 0: must be an integer >= 1" in refused("starts", "cluster", "--count", "0")
    assert "count = 100000000: must be at most" in refused("starts", "cluster", "--count", "100000000")
    (tmp_path / "mine.csv").write_text("")
    line = refused("starts", "cluster", "--count", "1", "--out", "mine.csv", files=1)
    assert "mine.csv is there already: choose another --out" in line


def test_another_run_is_not_overwritten(refused, discovered, tiny_toml, tmp_path):
    before = contents(discovered)
    line = refused("discover", tiny_toml, "--out", discovered)
    assert "holds another run: continue it with --resume, or choose another --out" in line
    line = refused("discover", tiny_toml, "--out", discovered, "--resume", "--seed", "1")
    assert "holds another experiment: seed is 0 there, 1 here; choose another folder" in line
    assert contents(discovered) == before
    (tmp_path / "file").write_text("")
    assert "cannot write to file" in refused("discover", tiny_toml, "--out", "file", files=1)
    assert "holds other files" in refused("discover", tiny_toml, "--out", ".", files=1)


@pytest.mark.parametrize("verb", ["evaluate", "show", "table"])
def test_damaged_runs(refused, discovered, tmp_path, verb):
    run = shutil.copytree(discovered, tmp_path / "run")
    policy = run / "policies" / "0-base.safetensors"
    policy.write_bytes(policy.read_bytes() + b"x")
    assert "0-base.safetensors does not match its checksum" in refused(verb, "run", files=1)
    manifest = json.loads((run / "manifest.json").read_text())
    (run / "manifest.json").write_text(json.dumps(manifest | {"format": 99}))
    assert "has format 99; this version of murmurate reads formats 1 and 2" in refused(verb, "run", files=1)
    (run / "manifest.json").write_text("{")
    assert "is not valid JSON" in refused(verb, "run", files=1)
    (run / "manifest.json").unlink()
    assert "unfinished run: finish it with murmurate discover --resume" in refused(verb, "run", files=1)


def test_no_such_episode(refused, discovered):
    before = contents(discovered)
    assert "episode = 200: must be an integer >= 0 and <= 199" in refused("show", discovered, "--episode", "200")
    assert contents(discovered) == before


def test_mp4_needs_the_video_extra(refused, discovered, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    before = contents(discovered)
    assert "the video extra installed" in refused("show", discovered, "--mp4")
    assert contents(discovered) == before


def test_a_full_disk(tiny_toml, discovered, refused, tmp_path):
    """No file can grow beyond 4 KiB, which is what a full disk looks like."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = contents(discovered)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        assert "cannot write to run: File too large" in refused("discover", tiny_toml, "--out", "run")
        assert "cannot write" in refused("evaluate", discovered, "--episodes", "200", "--quiet")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert contents(discovered) == before


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="root, and Windows, may write anywhere")
def test_a_read_only_folder(tiny_toml, refused, tmp_path):
    tmp_path.chmod(0o500)
    try:
        assert "cannot write to run: Permission denied" in refused("discover", tiny_toml, "--out", "run")
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="no /proc")
def test_a_read_only_disk(tiny_toml, refused):
    assert "cannot write to /proc/run" in refused("discover", tiny_toml, "--out", "/proc/run")


def test_the_process_says_it_too(tmp_path):
    code = "import sys; from murmurate.cli.main import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["discover", "C", "--world.radius", "-1"]
    result = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "murmurate: world.radius = -1.0: must be a finite number > 0 and <= 1e+09\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with a name")
@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("sweep pipe.toml --out out", "pipe.toml: it is no regular file"),
        ("discover C --config pipe.toml", "pipe.toml: it is no regular file"),
        ("discover pipe.toml", "experiment = 'pipe.toml': must be an existing TOML file: it is no regular file"),
        ("evaluate pipe.toml", "pipe.toml holds no run: it has no manifest.json"),
        ("starts cluster --out pipe.toml/x.csv", "pipe.toml"),
    ],
)
def test_errors_about_files_name_them(refused, words, line):
    os.mkfifo("pipe.toml")
    assert line in refused(*words.split(), files=1)


def test_a_file_that_is_too_large_is_named(refused, tmp_path):
    with (tmp_path / "large.toml").open("wb") as file:
        file.truncate(1 << 30)  # takes no space on disk
    assert refused("sweep", "large.toml", files=1) == "large.toml: it is larger than 1024 KiB, the most that is read"
