"""The console command: `torchdt track scenario=line_array`."""

import argparse
import os
import sys
from importlib import import_module

import hydra
from omegaconf import DictConfig

from torchdt import __version__
from torchdt.core.endings import INTERRUPTED, end

JOBS = {
    "track": "track a scenario or a recording",
    "tune": "tune the model on the likelihood of sequences, by gradient or search",
    "compare": "compare trackers on a suite of scenarios",
}
"""Commands whose arguments are Hydra's, and what they do."""

COMMANDS = {
    **JOBS,
    "collect": "turn the run directories of sweeps into one table and one figure",
    "doctor": "print versions and devices, and check in seconds that tracking works here",
}
"""All commands."""

EPILOG = """\
torchdt COMMAND --help lists the arguments of a command.

Shell completion of commands, configuration groups and keys, also for a shell's start-up file
(`uninstall` instead of `install` takes it back):

  bash  eval "$(torchdt -sc install=bash)"
  zsh   autoload -U bashcompinit && bashcompinit && eval "$(torchdt -sc install=bash)"
  fish  torchdt -sc install=fish | source
"""


def main() -> None:
    """Run the command that `sys.argv` names; one that does not exist exits with status 2."""
    if sys.argv[1:2] in (["-sc"], ["--shell-completion"]):
        complete()
        return
    parser = argparse.ArgumentParser(
        prog="torchdt",
        description="Direct multiobject tracking from the snapshots of a sensor array.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"torchdt {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    for name, summary in COMMANDS.items():
        commands.add_parser(name, help=summary, add_help=False)
    try:
        start(parser.parse_args(sys.argv[1:2]).command)
    except KeyboardInterrupt:
        end(INTERRUPTED, "interrupted")


def start(name: str) -> None:
    """Call a command with the arguments that follow its name; its imports wait until then."""
    del sys.argv[1]
    if name in JOBS:
        import_module("torchdt.app.job").job(name)()
    else:
        sys.argv[0] = f"torchdt {name}"
        import_module(f"torchdt.app.{name}").main()


def complete() -> None:
    """Print a shell's script for completion, or what the word at the cursor may become.

    The scripts are Hydra's. They call `torchdt -sc query=SHELL` with the line so far in `COMP_LINE`: the
    command is completed here, and where it is a job, Hydra completes the rest as that job's.
    """
    line = os.environ.get("COMP_LINE", "").lstrip()
    done = line.split() if line.endswith(" ") else line.split()[:-1]
    if not any(argument.startswith("query=") for argument in sys.argv):
        hydra.main(config_path=None, version_base="1.3")(_nothing)()
    elif len(done) < 2:
        sys.stdout.write("\n".join(COMMANDS) + "\n")
    elif done[1] in JOBS:
        os.environ["COMP_LINE"] = line[len(done[0]) :].lstrip()
        sys.argv.insert(1, done[1])
        start(done[1])


def _nothing(config: DictConfig) -> None:
    """A job that lends Hydra's completion scripts, without the imports of another one."""
