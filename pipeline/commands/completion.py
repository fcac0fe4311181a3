"""`dealab completion`: scripts for shells, made from the commands as they are, so that none is forgotten.

dealab completion bash > ~/.local/share/bash-completion/completions/dealab
dealab completion zsh  > ~/.zfunc/_dealab                 (a folder of $fpath)
dealab completion fish > ~/.config/fish/completions/dealab.fish
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from pipeline.commands.command import DONE, Command, argument

Commands: TypeAlias = Mapping[str, tuple[str, argparse.ArgumentParser]]
"""By name: what the command does, and its parser."""


def run(arguments: argparse.Namespace) -> int:
    commands = {}
    for name, command in arguments.commands.items():
        parser = argparse.ArgumentParser(prog=f"dealab {name}")
        for add in command.arguments:
            add(parser)
        commands[name] = command.what, parser
    print(SHELLS[arguments.shell](commands), end="")
    return DONE


def _list_options(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return [a for a in parser._actions if a.option_strings]


def _list_words(parser: argparse.ArgumentParser) -> list[str]:
    return [name for a in _list_options(parser) for name in a.option_strings if name.startswith("--")]


def _list_choices(parser: argparse.ArgumentParser) -> list[tuple[str, Sequence[str]]]:
    """Options and positional arguments (empty name) that take one of a few words."""
    return [
        (a.option_strings[-1] if a.option_strings else "", [str(c) for c in a.choices])
        for a in parser._actions
        if a.choices is not None
    ]


def _write_bash(commands: Commands) -> str:
    cases = []
    for name, (_, parser) in commands.items():
        previous = "".join(
            f"\n        {option}) COMPREPLY=($(compgen -W '{' '.join(words)}' -- \"$current\")); return ;;"
            for option, words in _list_choices(parser)
            if option
        )
        chosen = f"\n      case $previous in{previous}\n      esac" if previous else ""
        fixed = " ".join(word for option, words in _list_choices(parser) if not option for word in words)
        words = " ".join([*_list_words(parser), *fixed.split()])
        cases.append(f"    {name}){chosen}\n      words='{words}' ;;")
    return f"""# Completion of dealab for bash; made by `dealab completion bash`.
_dealab() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}} words=''
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W '{" ".join(commands)} --help --version' -- "$current"))
    return
  fi
  case ${{COMP_WORDS[1]}} in
{chr(10).join(cases)}
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
  case $current in
    -*) ;;
    *) COMPREPLY+=($(compgen -f -- "$current")) ;;
  esac
}}
complete -o filenames -F _dealab dealab
"""


def _quote(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"


def _write_zsh(commands: Commands) -> str:
    described = "\n".join(f"    {_quote(f'{name}:{what}')}" for name, (what, _) in commands.items())
    cases = "\n".join(
        f"    {name}) _arguments {_describe_for_zsh(parser)} ;;" for name, (_, parser) in commands.items()
    )
    return f"""#compdef dealab
# Completion of dealab for zsh; made by `dealab completion zsh`.
_dealab() {{
  local -a commands
  commands=(
{described}
  )
  if (( CURRENT == 2 )); then
    _describe -t commands 'dealab command' commands
    return
  fi
  local command=$words[2]
  shift words
  (( CURRENT-- ))
  case $command in
{cases}
  esac
}}
_dealab "$@"
"""


def _describe_for_zsh(parser: argparse.ArgumentParser) -> str:
    parts = []
    for a in parser._actions:
        text = _escape_for_zsh(a.help)
        action = f"({' '.join(str(c) for c in a.choices)})" if a.choices is not None else "_files"
        if not a.option_strings:
            parts.append(_quote(f"{'*' if a.nargs in ('*', '+') else ''}:{_escape_for_zsh(a.dest)}:{action}"))
            continue
        for name in a.option_strings:
            value = "" if a.nargs == 0 else f":{_escape_for_zsh(a.dest)}:{action}"
            parts.append(_quote(f"{name}[{text}]{value}"))
    return " ".join(parts)


def _escape_for_zsh(text: str | None) -> str:
    return "".join(f"\\{c}" if c in "[]:\\" else c for c in text or "")


def _write_fish(commands: Commands) -> str:
    lines = ["# Completion of dealab for fish; made by `dealab completion fish`."]
    for name, (what, parser) in commands.items():
        lines.append(f"complete -c dealab -n __fish_use_subcommand -f -a {name} -d {_quote(what)}")
        here = f"complete -c dealab -n '__fish_seen_subcommand_from {name}'"
        for a in parser._actions:
            words = f" -f -a {_quote(' '.join(str(c) for c in a.choices))}" if a.choices is not None else ""
            if not a.option_strings:
                lines += [here + words] if words else []
                continue
            takes = "" if a.nargs == 0 else " -r"
            names = "".join(f" -l {n[2:]}" if n.startswith("--") else f" -s {n[1:]}" for n in a.option_strings)
            lines.append(f"{here}{names}{takes}{words} -d {_quote(a.help or '')}")
    return "\n".join(lines) + "\n"


SHELLS: Mapping[str, Callable[[Commands], str]] = {"bash": _write_bash, "zsh": _write_zsh, "fish": _write_fish}
"""What writes the script of each shell."""

COMMAND = Command(
    "completion",
    "completion of commands and options for a shell",
    ("bash > ~/.local/share/bash-completion/completions/dealab", "zsh > ~/.zfunc/_dealab", "fish | source"),
    (argument("shell", choices=tuple(SHELLS), help="the shell"),),
    run,
)
