"""The command line: which commands there are; a command's module is loaded when it is called."""

import errno
import functools
import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import steerkit
from steerkit.cli import WORDS

COMMANDS: dict[str, list[str]] = WORDS["commands"]
"""Module and one line of help of every command: the function of its name there, or the group `app`."""
EPILOG: str = WORDS["help"]["epilog"]


class LazyGroup(TyperGroup):
    """Commands of `COMMANDS`, each imported when it is called; a list of them needs none."""

    def __init__(self, **options: Any):
        super().__init__(**options)
        self.commands = {name: TyperCommand(name, help=about) for name, (_, about) in COMMANDS.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] not in COMMANDS:
            return super().resolve_command(ctx, args)
        return args[0], loaded(args[0]), args[1:]


@functools.cache
def loaded(name: str) -> Any:
    """The command of that name."""
    module = import_module(COMMANDS[name][0])
    if hasattr(module, "app"):
        return typer.main.get_command(module.app)
    alone = typer.Typer(add_completion=False)
    alone.command(name)(getattr(module, name))
    return typer.main.get_command(alone)


app = typer.Typer(
    cls=LazyGroup,
    help="Steer a car along a path: learn it, drive it, look at it. No car was ever driven with this software.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"steerkit {steerkit.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    code: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE.py", help="Your own code that files may name, or a module; else none of it is run."),
    ] = None,
) -> None:
    """What goes before the command."""
    if code:
        from steerkit._support.plugins import mine

        for name in code:
            mine(name)


@functools.cache
def command() -> Any:
    """The command line as click has it."""
    return typer.main.get_command(app)


def main() -> None:
    """Run the command line; a mistake of the user's is one line on stderr and exit code 2."""
    try:
        command()()
    except (ValueError, KeyError, OSError) as error:
        from steerkit._support.errors import in_one_line  # here, as it loads NumPy

        print(f"steerkit: {in_one_line(error)}", file=sys.stderr)
        full = isinstance(error, OSError) and error.errno in _NO_ROOM
        raise SystemExit(1 if full else 2) from None


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


if __name__ == "__main__":
    main()
