"""`cablejax completion`: a script that lets bash or zsh complete commands, options and their choices."""

import argparse
from typing import Any

BASH = """\
_cablejax() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} command=${{COMP_WORDS[1]}}
  COMPREPLY=()
  if [ "$COMP_CWORD" -eq 1 ]; then COMPREPLY=($(compgen -W "{commands}" -- "$word")); return; fi
  case "$command $before" in
{choices}
  esac
  case "$word" in
    -*) case "$command" in
{options}
      esac ;;
    *) COMPREPLY=($(compgen -f -- "$word")) ;;
  esac
}}
complete -o filenames -F _cablejax cablejax
"""


HELP = "a script for the shell: source <(cablejax completion bash)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("shell", choices=("bash", "zsh"))


def run(options: argparse.Namespace) -> dict[str, Any]:
    """The script for a shell, made from the command's own parser, `options.completed`."""
    (sub,) = [action for action in options.completed._actions if isinstance(action, argparse._SubParsersAction)]
    choices, names = [], []
    for command, parser in sub.choices.items():
        flags = [action for action in parser._actions if action.option_strings]
        words = " ".join(flag for action in flags for flag in action.option_strings)
        names.append(f'        {command}) COMPREPLY=($(compgen -W "{words}" -- "$word")) ;;')
        for action in flags:
            if action.choices is not None:
                values = " ".join(str(value) for value in action.choices)
                line = f'COMPREPLY=($(compgen -W "{values}" -- "$word")); return ;;'
                choices += [f'    "{command} {flag}") {line}' for flag in action.option_strings]
    script = BASH.format(commands=" ".join(sub.choices), choices="\n".join(choices), options="\n".join(names))
    if options.shell == "zsh":
        script = "autoload -U +X compinit bashcompinit\ncompinit\nbashcompinit\n" + script
    return {"shell": options.shell, "script": script}


def table(result: dict[str, Any]) -> str:
    """The script alone: `source <(cablejax completion bash)`."""
    return result["script"]
