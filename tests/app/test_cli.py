"""The console command, in this process and as a shell sees it."""

import subprocess
import sys

import pytest
from oracles.scripts import SMALL, call

from torchdt import __version__
from torchdt.app import cli

pytestmark = pytest.mark.slow
FAST = ("scenario=line_array", *SMALL, "scenario.num_steps=3", "logging=quiet")
COMPLETE = """
eval "$(torchdt -sc install=bash)"
COMP_LINE=$1 COMP_POINT=${#1}
COMP_WORDS=($1)
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
$(complete -p torchdt | sed 's/.*-F \\([^ ]*\\).*/\\1/')
printf '%s\\n' "${COMPREPLY[@]}"
"""
"""What bash does when the tabulator is pressed at the end of the line `$1`."""


@pytest.fixture
def torchdt(tmp_path, monkeypatch):
    """The command with some arguments, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "__file__", "torchdt")  # the name under which it is called
    return lambda *arguments: call(cli, *arguments)


@pytest.fixture(scope="module")
def shell(tmp_path_factory):
    """Bash with the command on its path."""
    folder = tmp_path_factory.mktemp("bin")
    command = folder / "torchdt"
    command.write_text(f"#!{sys.executable}\nfrom torchdt.app.cli import main\nmain()\n")
    command.chmod(0o755)

    def shell(*arguments):
        done = subprocess.run(
            ["bash", "-c", *arguments],
            env={"PATH": f"{folder}:/usr/bin:/bin"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    return shell


def test_track_is_the_job_of_the_script(torchdt, tmp_path):
    status, out, err = torchdt("track", *FAST, "hydra.run.dir=run")
    assert status == 0, err
    assert "tracker direct, line_array" in out
    assert {"metrics.json", "track.log", "tracks.csv"} <= {path.name for path in (tmp_path / "run").iterdir()}


@pytest.mark.parametrize("name", cli.JOBS)
def test_jobs_take_the_arguments_of_hydra(torchdt, name):
    status, out, err = torchdt(name, "--cfg=hydra", "--package=hydra.job")
    assert status == 0, err
    assert f"name: {name}\n" in out  # and of its log
    assert f"config_name: {name}\n" in out


def test_multirun(torchdt, tmp_path):
    status, out, err = torchdt("track", "-m", "seed=0,1", *FAST, "hydra.sweep.dir=sweep")
    assert status == 0, err
    assert "┃" not in out  # no tables
    assert len(list((tmp_path / "sweep").glob("*/metrics.json"))) == 2


@pytest.mark.parametrize("words", [["trakc"], []])
def test_unknown_command(torchdt, words):
    status, _, err = torchdt(*words)
    assert status == 2
    assert "COMMAND" in err
    if words:
        assert f"'trakc' (choose from {', '.join(map(repr, cli.COMMANDS))})" in err


def test_help_and_version(torchdt):
    status, out, _ = torchdt("--help")
    assert status == 0
    for name, summary in cli.COMMANDS.items():
        assert f"{name} " in out
        assert summary.split()[0] in out
    assert torchdt("--version")[:2] == (0, f"torchdt {__version__}\n")


def test_every_command_exists(torchdt):
    for name in cli.COMMANDS.keys() - cli.JOBS.keys():
        status, out, _ = torchdt(name, "--help")
        assert status == 0
        assert out.startswith(f"usage: torchdt {name}")


def test_bash_completes_commands(shell):
    assert shell(COMPLETE, "bash", "torchdt tr") == ["track"]


def test_bash_completes_what_hydra_knows_of_the_job(shell):
    assert shell(COMPLETE, "bash", "torchdt track scenario=clo") == [
        "scenario=close_6db",
        "scenario=close_equal",
    ]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("torchdt ", [*cli.COMMANDS]),
        ("torchdt tr", [*cli.COMMANDS]),  # the shell picks
        ("torchdt tune tuning=", ["tuning=gradient", "tuning=grid", "tuning=tpe"]),
        ("torchdt track -m tracker.part", ["tracker.particles="]),
        ("torchdt doctor ", []),
    ],
)
def test_queries(torchdt, monkeypatch, line, found):
    for shell in ("bash", "fish"):
        monkeypatch.setenv("COMP_LINE", line)
        status, out, err = torchdt("-sc", f"query={shell}")
        assert status == 0, err
        assert out.split() == found


@pytest.mark.parametrize(
    ("flag", "shell"), [("-sc", "bash"), ("-sc", "zsh"), ("-sc", "fish"), ("--shell-completion", "bash")]
)
def test_scripts_of_the_shells(torchdt, flag, shell):
    status, out, err = torchdt(flag, f"install={shell}")
    assert status == 0, err
    assert "torchdt" in out
    assert "query=" in out


def test_commands_are_quick_to_name():
    """PyTorch takes longer than anyone waits for a completion."""
    program = "import sys, torchdt.app.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
