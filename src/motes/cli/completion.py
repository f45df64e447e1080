"""`motes completion bash | zsh | fish`: what a shell needs to complete commands, applications, files and options."""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from motes.cli.asked import Plan, Run, Study, Watch, application, applications
from motes.cli.calibrate import Calibrate
from motes.cli.demo import demonstrations
from motes.cli.options import first_and_flags, from_flags, refuse, shown
from motes.cli.report import Report
from motes.core.spelling import perhaps

USAGE = "motes completion SHELL"
SHELLS = ("bash", "zsh", "fish")
CHOOSING = ("--filter", "--filter.n", "--smoother")
"""Flags that choose records."""
OPTIONS: dict[str, tuple[type, tuple[str, ...]]] = {
    "demo": (Run, CHOOSING), "run": (Run, CHOOSING), "plan": (Plan, ()), "watch": (Watch, CHOOSING[:2]), "study": (Study, ("--filters",)),
    "calibrate": (Calibrate, ()), "report": (Report, ()),
}  # fmt: skip

BASH = """# completion of motes: eval "$(motes completion {own})"
_motes() {{
    local cur="${{COMP_WORDS[COMP_CWORD]}}" command="${{COMP_WORDS[1]}}" first="${{COMP_WORDS[2]}}" words=""
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{commands} --help --version" -- "$cur"))
        return
    fi
    case "$command" in
{commands_cases}
    esac
    case "$command $first" in
{applications_cases}
    esac
    if [ "$COMP_CWORD" -eq 2 ] && [[ "$cur" != -* ]]; then
        case "$command" in
{first_cases}
        esac
    elif [[ "$cur" != -* ]]; then
        words=""
    fi
    COMPREPLY=($(compgen -W "$words" -- "$cur") $([[ "$cur" != -* && "$command" != demo ]] && compgen -f -- "$cur"))
}}
complete -o filenames -F _motes motes
"""


@dataclass(frozen=True)
class Completion:
    """Print what a shell needs to complete the words of motes; SHELL (bash, zsh or fish) comes first.

    In bash and zsh: eval "$(motes completion bash)", or zsh, in the file that the shell reads at its start; in fish: motes completion
    fish > ~/.config/fish/completions/motes.fish
    """


def main(words: Sequence[str]) -> None:
    """Print the script.

    Raises:
        MotesError: no shell is named, or one that is not known.
    """
    shell, flags = first_and_flags(Completion(), words, USAGE, f"the name of a shell first: {', '.join(SHELLS)}", "")
    from_flags(Completion(), flags, USAGE)
    if shell not in SHELLS:
        refuse("shell", f"one of {', '.join(SHELLS)}", shown(shell), perhaps(shell, SHELLS))
    print(_fish() if shell == "fish" else _bash(shell), end="")


def _bash(shell: str) -> str:
    from motes.cli.main import COMMANDS

    first = _first()
    script = BASH.format(
        own=shell, commands=" ".join(COMMANDS),
        first_cases="\n".join(f'            {name}) words="{" ".join(known)}" ;;' for name, known in first.items()),
        commands_cases="\n".join(f'        {name}) words="{" ".join(_flags(name))}" ;;' for name in OPTIONS),
        applications_cases="\n".join(f'        *" {name}") words="$words {" ".join(_own(name))}" ;;' for name in first["demo"]),
    )  # fmt: skip
    return f"autoload -U +X bashcompinit && bashcompinit\n{script}" if shell == "zsh" else script


def _fish() -> str:
    from motes.cli.main import COMMANDS

    lines = ["# completion of motes: motes completion fish > ~/.config/fish/completions/motes.fish"]
    lines += [f"complete -c motes -f -n __fish_use_subcommand -a {name} -d '{does}'" for name, does in COMMANDS.items()]
    lines += [f"complete -c motes -n '__fish_seen_subcommand_from {name}' -a '{' '.join(known)}'" for name, known in _first().items()]
    for name in OPTIONS:
        seen = f"'__fish_seen_subcommand_from {name}'"
        lines += [f"complete -c motes -n {seen} -l {flag[2:]}" for flag in _flags(name)]
    for name in applications():
        lines += [f"complete -c motes -n '__fish_seen_subcommand_from {name}' -l {flag[2:]}" for flag in _own(name)]
    return "\n".join(lines) + "\n"


def _first() -> dict[str, list[str]]:
    """Return the words of which one comes first after a command."""
    names = list(applications())
    return {"demo": [*names, *demonstrations()], **dict.fromkeys(("run", "plan", "watch", "study"), names), "completion": list(SHELLS)}


def _flags(command: str) -> list[str]:
    """Return the flags of a command."""
    kind, more = OPTIONS[command]
    return [*_of(kind()), *more, "--help"]


def _own(name: str) -> list[str]:
    """Return the flags of an application."""
    return list(_of(application(demonstrations().get(name, name), "").settings()))


def _of(settings: object, prefix: str = "--") -> Iterator[str]:
    for field in dataclasses.fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, field.name)
        name = prefix + field.name.replace("_", "-")
        if dataclasses.is_dataclass(value):
            yield from _of(value, f"{name}.")
        else:
            yield name
