"""Completion of the command line in bash, zsh and fish: scripts that are generated from the parser."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from typing import Any, NoReturn

SHELLS = ("bash", "zsh", "fish")

Parsers = list[tuple[str, argparse.ArgumentParser]]

# The words before the cursor determine the command, and the last word may be an option with a choice of values. If the
# script offers no words, bash offers files.
BASH = """\
_loewner() {{
  local word command= cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[$((COMP_CWORD - 1))]}} offers=
  for word in "${{COMP_WORDS[@]:1:$((COMP_CWORD - 1))}}"; do
    case "$command $word" in {commands}) command="${{command:+$command }}$word" ;; esac
  done
  case "$command $prev" in
{values}
    *) case "$command" in
{words}
      esac ;;
  esac
  COMPREPLY=($(compgen -W "$offers" -- "$cur"))
}}
complete -o default -F _loewner loewner
"""

ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"

FISH = """\
function __loewner_command
  set -l command
  for word in (commandline -opc)[2..]
    switch "$command $word"
      case {commands}
        set command (string trim "$command $word")
    end
  end
  echo "$command"
end
"""


class PrintCompletion(argparse.Action):
    """An option that prints the completion script for a shell and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, _: argparse.Namespace, shell: Any, __: Any = None) -> NoReturn:
        """Print the script for the parser that has this option."""
        print(script(parser, shell), end="")
        parser.exit()


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Write a script for one of `SHELLS` that completes the commands and options of a parser."""
    parsers = list(_parsers(parser))
    return _fish(parsers) if shell == "fish" else (ZSH if shell == "zsh" else "") + _bash(parsers)


def _parsers(parser: argparse.ArgumentParser, *names: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the words and the parser of each command. The program itself has no words."""
    yield " ".join(names), parser
    for name, inner in _commands(parser).items():
        yield from _parsers(inner, *names, name)


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the commands of a parser."""
    actions = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return next((dict(action.choices) for action in actions), {})


def _options(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return [action for action in parser._actions if action.option_strings]


def _patterns(parsers: Parsers, between: str) -> str:
    """Write each word that is a command, preceded by the words before it and a blank."""
    patterns = (f"{above} {name}" for above, parser in parsers for name in _commands(parser))
    return between.join(map(shlex.quote, patterns))


def _bash(parsers: Parsers) -> str:
    values, words = [], []
    for command, parser in parsers:
        names = [name for option in _options(parser) for name in option.option_strings]
        # Commands come first. If there are no commands, a word that does not begin like an option is a file.
        commands, options = " ".join(_commands(parser)), " ".join(names)
        words.append(f"      {command!r}) case $cur in -*) offers={options!r} ;; *) offers={commands!r} ;; esac ;;")
        for option in _options(parser):
            if option.choices is not None:
                some = "|".join(shlex.quote(f"{command} {name}") for name in option.option_strings)
                values.append(f"    {some}) offers={' '.join(map(str, option.choices))!r} ;;")
    return BASH.format(commands=_patterns(parsers, "|"), values="\n".join(values), words="\n".join(words))


def _fish(parsers: Parsers) -> str:
    lines = [FISH.format(commands=_patterns(parsers, " "))]
    for command, parser in parsers:
        begin = f'complete -c loewner -n \'test "$(__loewner_command)" = "{command}"\''
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for inner in action._choices_actions:
                    lines.append(f"{begin} -f -a {inner.dest} -d {_quoted(inner.help)}")
        for option in _options(parser):
            names = " ".join(f"-l {n[2:]}" if n.startswith("--") else f"-s {n[1:]}" for n in option.option_strings)
            choices = f" -x -a '{' '.join(map(str, option.choices))}'" if option.choices is not None else ""
            value = " -r" if option.nargs != 0 and not choices else ""
            lines.append(f"{begin} {names}{choices}{value} -d {_quoted(parser._get_formatter()._expand_help(option))}")
    return "\n".join(lines) + "\n"


def _quoted(text: str | None) -> str:
    """Quote a help text for fish, where a backslash keeps its meaning between single quotes."""
    return "'" + (text or "").replace("\\", "\\\\").replace("'", "\\'") + "'"
