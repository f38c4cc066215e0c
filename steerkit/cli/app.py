"""The command line: which commands there are; a command's module is loaded when it is called."""

from __future__ import annotations

import errno
import functools
import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import steerkit

COMMANDS = {
    "courses": ("steerkit.cli.lists", "List the courses; or what a map's FILE holds, and make a course of it."),
    "vehicles": ("steerkit.cli.lists", "List the cars: those by name, and the fleet of production cars."),
    "new": ("steerkit.cli.new", "Write a controller, vehicle, course, plant or scenario to begin with."),
    "drive": ("steerkit.cli.drive", "Drive with any controller: a course in simulation, or with --car FILE a car."),
    "sweep": ("steerkit.cli.sweep", "Drive with hundreds of values of a controller's or a car's parameters at once."),
    "learn": ("steerkit.cli.learn", "Let a car learn to steer a course from nothing."),
    "show": ("steerkit.cli.learn", "Show a learning run: counts, episodes, learned against Stanley, and its pictures."),
    "demo": ("steerkit.cli.demo", "Learn on the 800 m course and on a real recorded lap; compare with Stanley."),
    "log": ("steerkit.cli.log", "Show what is in a log: its channels, what each is read as, and the drive they make."),
    "plot": ("steerkit.cli.log", "Plot signals of a log over time."),
    "prove": ("steerkit.cli.prove", "Manoeuvres of vehicle testing: drive one, find it in a log, judge it."),
    "identify": ("steerkit.cli.identify", "Estimate a car's steering and cornering stiffness from a recorded drive."),
    "resimulate": ("steerkit.cli.resimulate", "Drive a recorded drive again in simulation, with another controller."),
    "export": ("steerkit.cli.export", "Export a learning run, a log or a car for other programs."),
    "car": ("steerkit.cli.car", "A car on a CAN bus: check its configuration, simulate one, look into recordings."),
    "bench": ("benchmarks.app", "Learned against analytic steering controllers, in numbers."),
}
"""Module and one line of help of every command: the function of its name there, or the group `app`."""
EPILOG = """
Examples

  steerkit courses                            what can be driven\n
  steerkit vehicles toyota                    with which cars\n
  steerkit drive stanley --course genesis     a controller on a course\n
  steerkit learn --minutes 2 --out runs/mine  a car learns; the run is kept\n
  steerkit show runs/mine                     what it came to, and its pictures\n
  steerkit log lap.mcap                       what is in a log of any program\n
  steerkit drive runs/mine -q --json          its figures, for a program\n

Exit codes: 0 done; 1 refused or failed on the way; 2 a mistake in what was asked, said in one line on stderr;
130 interrupted. NO_COLOR=1 leaves out colours. Completion for your shell: steerkit --install-completion.
"""


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
