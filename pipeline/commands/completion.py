"""`dealab completion`: scripts for shells, made by shtab from the commands as they are, so that none is forgotten.

dealab completion bash > ~/.local/share/bash-completion/completions/dealab
dealab completion zsh  > ~/.zfunc/_dealab                 (a folder of $fpath)
dealab completion fish > ~/.config/fish/completions/dealab.fish
"""

from __future__ import annotations

import argparse

from pipeline.commands.command import DONE, Command, argument

_SHELLS = ("bash", "zsh", "fish")


def run(arguments: argparse.Namespace) -> int:
    import shtab

    parser = arguments.make_parser(arguments.commands)
    _offer_files(parser, shtab.FILE)
    print(shtab.complete(parser, shell=arguments.shell))
    return DONE


def _offer_files(parser: argparse.ArgumentParser, files: object) -> None:
    """Offers names of files wherever a value is none of a few words."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _offer_files(command, files)
        elif action.choices is None and action.nargs != 0:
            action.complete = files  # type: ignore[attr-defined]  # where shtab looks for it


COMMAND = Command(
    ("bash > ~/.local/share/bash-completion/completions/dealab", "zsh > ~/.zfunc/_dealab", "fish | source"),
    (argument("shell", choices=_SHELLS, help="the shell"),),
    run,
)
