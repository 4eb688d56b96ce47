"""`tdgbench` and `python -m tdgbench`: run a tool, or compose a configuration with Hydra and run its job."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig

from tdgbench import __version__
from tdgbench.experiments.experiment import experiment_of
from tdgbench.resources import conf_folder
from tdgbench.terminal import guard_streams, say
from tdgbench.tools import TOOLS
from tdgbench.usage import usage

DEMO = "+experiment=demo"


def main() -> int:
    """Run what the command line asks for; return the exit status.

    The first word chooses a tool. Without one, Hydra takes the arguments. No arguments: the demo.
    """
    guard_streams()
    words = sys.argv[1:]
    if str(Path.cwd()) not in sys.path and not sys.flags.safe_path:
        sys.path.append(str(Path.cwd()))  # plug-ins in the working folder, as `python -m` finds them
    if words and words[0] in TOOLS:
        return TOOLS[words[0]].run(words[1:])
    if words and "=" not in words[0] and words[0][:1] not in "-+~":
        say(f"tdgbench: no tool {words[0]!r} (tools: {', '.join(TOOLS)}); see tdgbench --help", stderr=True)
        return 2
    if {"--help", "-h"} & set(words):
        say(usage())
    elif "--version" in words:
        say(f"tdgbench {__version__}")
    else:
        if not words:
            sys.argv.append(DEMO)
        run_experiment()
    return 0


@hydra.main(config_path=str(conf_folder()), config_name="config", version_base="1.3")
def run_experiment(cfg: DictConfig) -> None:
    """Run the experiment that the composed configuration names."""
    experiment_of(cfg).run(cfg)


if __name__ == "__main__":
    sys.exit(main())
