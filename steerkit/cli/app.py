"""The command line: one small file a command, put together here."""

from __future__ import annotations

import errno
import functools
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

import steerkit
from steerkit.cli.bench import app as bench_app
from steerkit.cli.car import app as car_app
from steerkit.cli.courses import courses
from steerkit.cli.drive import drive
from steerkit.cli.export import export
from steerkit.cli.identify import identify
from steerkit.cli.learn import learn
from steerkit.cli.log import log
from steerkit.cli.options import Quiet, Seed
from steerkit.cli.plot import plot
from steerkit.cli.resimulate import resimulate
from steerkit.cli.show import show
from steerkit.cli.vehicles import vehicles

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
app = typer.Typer(
    help="Steer a car along a path: learn it, drive it, look at it. No car was ever driven with this software.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.add_typer(car_app, name="car")
app.add_typer(bench_app, name="bench")
app.command()(log)
app.command()(identify)
app.command()(export)
app.command()(learn)
app.command()(drive)
app.command()(resimulate)
app.command()(show)
app.command()(plot)
app.command()(courses)
app.command()(vehicles)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"steerkit {steerkit.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """What goes before the command."""


@app.command()
def demo(
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(help="Where runs and pictures go.")] = Path("runs/demo"),
    quiet: Quiet = False,
) -> None:
    """Learn on the 800 m course and on a real recorded lap; compare with Stanley; redraw the paper's figures."""
    from steerkit.cli import demo as learner_state

    learner_state.run(out, seed=seed, quiet=quiet)


@functools.cache
def command() -> Any:
    """The commands as click has them; to put them together takes longer than many a command."""
    return typer.main.get_command(app)


def main() -> None:
    """Run the command line; a mistake of the user's is one line on stderr and exit code 2."""
    try:
        command()()
    except (ValueError, KeyError, OSError) as error:
        from steerkit._support.errors import in_one_line

        print(f"steerkit: {in_one_line(error)}", file=sys.stderr)
        full = isinstance(error, OSError) and error.errno in _NO_ROOM
        raise SystemExit(1 if full else 2) from None


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


if __name__ == "__main__":
    main()
