"""The command line: python -m arm_blender generate | batch | finish | relight | weights | doctor.

Exit status: 0 done, 1 an item failed, 2 bad usage, 130 interrupted. An error is one line on stderr.
"""

import argparse
import logging
import os
import sys
import traceback
from typing import NoReturn

from .commands import UsageError, batch, doctor, finish, generate, interrupts, relight, weights
from .errors import ArmError
from .machine.run_folder import keep_temporary_files_together
from .version import VERSION

INTERRUPTED = 130

_COMMANDS = (generate, batch, finish, relight, weights, doctor)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage around it."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def main(argv: list[str] | None = None) -> int:
    """Runs one command; `argv` without the program's name, or None for the process's own. Returns the exit status."""
    try:
        args = parser().parse_args(argv)
    except SystemExit as stop:  # argparse ends the process itself; inside Blender it must go on.
        return int(stop.code or 0)
    logging.basicConfig(level=logging.DEBUG if args.debug else logging.WARNING, format="%(name)s: %(message)s")
    try:
        status = args.run(args)
        if sys.stdout is not None:  # Blender with a window has none on Windows.
            sys.stdout.flush()
        return status
    except ArmError as error:
        if args.debug:
            traceback.print_exc()
        print(f"arm: {error}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except ImportError as error:
        if args.debug or (error.name or "").startswith("arm_blender"):
            raise
        print(f"arm: {error}; `python -m arm_blender doctor` says what is missing", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # Who read our output has gone, as `head` does. What is still in the buffer has to go somewhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        print("arm: interrupted; nothing was left half-written", file=sys.stderr)
        return INTERRUPTED


def parser() -> argparse.ArgumentParser:
    """The parser of all commands; building it imports nothing heavy."""
    top = _Parser(prog="arm", description="From pictures of an object to a textured, relightable mesh.")
    top.add_argument("--version", action="version", version=VERSION)
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    for module in _COMMANDS:
        name = module.__name__.rpartition(".")[2]
        summary = (module.__doc__ or "").partition("\n")[0]
        command = commands.add_parser(name, help=summary, description=summary)
        command.add_argument("--debug", action="store_true", help="show tracebacks and what is going on")
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return top


def program() -> int:
    """`main` of a process that does nothing else."""
    interrupts.watch(interrupts.watched())
    keep_temporary_files_together()
    return main()


if __name__ == "__main__":
    sys.exit(program())
