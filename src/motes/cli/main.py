"""The command `motes`: each subcommand is one file with `main(arguments)`, imported when it is called.

Whatever the user gets wrong becomes one line on the error stream and exit code 2; Ctrl-C gives 130; 0 is success. Nothing here imports
JAX, so that `motes --help` answers at once.
"""

import importlib
import os
import sys
import warnings
from collections.abc import Sequence

from motes.cli import interruption

COMMANDS = {
    "demo": "run an application on a world of its own: terrain (the default), robot, aircraft, ...",
    "run": "run filters on an application or your own model, with your measurements",
    "plan": "choose filter, partition and number of particles for a time per step",
    "watch": "look at a filter while it works, on a page of this machine",
    "study": "compare filters on many simulated runs",
    "calibrate": "measure what the parts of a filter cost on this machine",
    "report": "write the web page of a study or a run from what is kept of it",
    "doctor": "print versions, devices and precision",
    "completion": "print what bash, zsh or fish needs to complete these words",
}


LONGEST = 500
"""Letters of a refusal."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand.

    Args:
        arguments: words after `motes`; if not given, those of the process, which is ended with the exit code.

    Returns:
        The exit code.
    """
    if arguments is not None:
        return _dispatch(list(arguments))
    words = sys.argv[1:]
    interruption.heed(" ".join(["motes", *(word for word in words[:1] if word in COMMANDS)]))
    code = _dispatch(words)
    interruption.leave(code)


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_usage())
        return 0
    if words[0] == "--version":
        from importlib.metadata import version

        print(f"motes {version('motes')}")
        return 0
    if words[0] not in COMMANDS:
        from motes.core.spelling import perhaps

        hint = perhaps(words[0], COMMANDS) or "See motes --help."
        print(f"motes: expected one of the commands {', '.join(COMMANDS)}, got {words[0][:80]!r}. {hint}", file=sys.stderr)
        return 2
    return _guarded(words[0], words[1:])


def _usage() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {does}" for name, does in COMMANDS.items()]
    return "\n".join(["usage: motes COMMAND [options]", "", "Monte Carlo state estimation.", "", *lines, "",
                      "motes COMMAND --help tells the options of a command.",
                      'eval "$(motes completion bash)" lets the shell complete them (or zsh).'])


def _guarded(name: str, words: list[str]) -> int:
    """Run a subcommand; turn refusals, warnings and interruptions into one line."""
    try:
        with warnings.catch_warnings():
            # in one line, too, and without a place in our own code
            warnings.showwarning = lambda message, *rest, **more: print(f"motes {name}: {message}", file=sys.stderr)
            importlib.import_module(f"motes.cli.{name}").main(words)
        if sys.stdout is not None:
            sys.stdout.flush()
    except KeyboardInterrupt:
        print(f"motes {name}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # the reader of our output has left, as in `motes doctor | head -1`; what is still buffered must not fail again at exit
        if sys.stdout is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (ValueError, RuntimeError, MemoryError) as reason:
        line = _in_one_line(reason)
        if line is None:
            raise
        said = f"motes {name}: {line}"
        print(said if len(said) <= LONGEST else said[: LONGEST - 3] + "...", file=sys.stderr)
        for note in getattr(reason, "__notes__", ()):
            # a table of TOML to be pasted; other libraries have notes of their own
            if note.startswith("["):
                print(note, file=sys.stderr)
        return 2
    return 0


def _in_one_line(reason: Exception) -> str | None:
    """Return what to tell the user of an exception, or None where it is a fault of ours, whose traceback is wanted."""
    from motes.core.checks import MotesError

    if isinstance(reason, MotesError):
        return str(reason)
    text = " ".join(str(reason).split())[:300]
    if isinstance(reason, MemoryError) or "RESOURCE_EXHAUSTED" in text:
        return "memory: expected enough for this number of particles and steps, got too little. Use fewer particles."
    if "Unable to initialize backend" in text:
        return f"device: expected one that JAX finds, got: {text}"
    return None


if __name__ == "__main__":
    sys.exit(main())
