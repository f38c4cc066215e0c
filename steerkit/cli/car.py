"""`steerkit car ...`: what goes with driving a car: check its configuration, simulate one, look into recordings."""

import contextlib
import json
import sys
from pathlib import Path as FilePath
from typing import Annotated

import typer

from steerkit._support.errors import known
from steerkit.car import calibration, estimates, processes
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import load
from steerkit.car.core import Core
from steerkit.car.panel import stream as show
from steerkit.car.panel import witness_line
from steerkit.car.production import platforms
from steerkit.car.senses import witness
from steerkit.car.state_machine import Order
from steerkit.cli.options import BusOptions, CarOptions, car_options, drive_options
from steerkit.diagram.units import radians_of
from steerkit.logs.foxglove import Server

app = typer.Typer(
    help="A car on a CAN bus. No car has been driven with this software: see docs/real-car.md.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

Config = Annotated[str, typer.Option("--config", help="TOML file, or a shipped one: dbw-kit.toml.")]
Socket = Annotated[str, typer.Option(help="Unix socket of the car server.")]


@app.command()
def check(config: Annotated[str, typer.Argument(help="TOML file, or a shipped one.")] = "dbw-kit.toml") -> None:
    """Check a configuration and print what would be read and written, and every limit."""
    car = load(config)
    path = car.course
    unlearned, bend = witness(car), float(abs(path.samples.kappa).max())
    print("\n".join(car.summary()))
    print(f"path     {path.name}, {path.length:.0f} m, {'closed' if path.closed else 'open'}")
    print("witness  before it has learned the car; on the panel as it is then")
    for v in sorted({2.0, 5.0, car.states.v_engage_max}):
        for where, kappa in (("straight", 0.0), ("bend", bend)):
            print(f"           {v:g} m/s, {where}: {witness_line(unlearned.astray(v, min(kappa, 2.0 / v**2)))}")
    print(f"{config}: no mistakes found")


@app.command("platforms")
def show_platforms(
    name: Annotated[str, typer.Argument(help="One of them, such as TESLA_MODEL_3; default: all.")] = "",
    by: Annotated[str, typer.Option(help="Only those steered by this: angle, curvature or torque.")] = "",
    out: Annotated[FilePath | None, typer.Option(help="Write a car's file for NAME, to be edited.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead, in SI units.")] = False,
) -> None:
    """Production cars that can be steered through opendbc: by what, from which speed, within which limits."""
    rows = [row for row in platforms.rows() if name in ("", row["name"]) and by in ("", row["by"])]
    if not rows:
        known(by, ("angle", "curvature", "torque"), "--by") if by else None
        platforms.platform(name)
    if out is not None:
        platforms.write(name, out)
        print(f"{out}: written for {name}; edit it, then: steerkit car check {out}")
    elif as_json:
        print(json.dumps({"platforms": rows}))
    else:
        print("\n".join(platforms.lines(rows)))


@app.command()
def simulate(
    ctx: typer.Context,
    config: Config = "dbw-kit.toml",
    channel: Annotated[
        str, typer.Option(help="INTERFACE:CHANNEL of python-can; default: slcan on a pseudo-terminal.")
    ] = "",
    time_scale: Annotated[float, typer.Option(help="How many times faster than real time.")] = 1.0,
    ratio: Annotated[float, typer.Option(help="True steering ratio over that of the data sheet.")] = 1.0,
    delay: Annotated[
        float | None, typer.Option(help="Dead time from a command to the motor (s): 0, a production car's own.")
    ] = None,
    lag: Annotated[float, typer.Option(help="Lag of the motor (s).")] = 0.1,
    offset_deg: Annotated[float, typer.Option(help="Offset of the steering that its sensor does not see (deg).")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the driver's speed.")] = 0,
    v_min: Annotated[float | None, typer.Option(help="Slowest speed (m/s): 4, of a production car 12.")] = None,
    v_max: Annotated[float | None, typer.Option(help="Fastest speed (m/s): 6, of a production car 16.")] = None,
    log: Annotated[str, typer.Option(help="File for every command heard, as JSON lines.")] = "",
) -> None:
    """A simulated car behind the same DBC on a bus of its own; faults come as lines on standard input.

    A line is KIND, `pose` or `report`, and perhaps LENGTH and AMOUNT: `drop pose 0.5`; an unknown one prints the kinds.
    """
    told = {name: value for name, value in ctx.params.items() if value is not None}
    offset = radians_of(told.pop("offset_deg"))
    raise typer.Exit(processes.simulate(**told, offset=offset))


@app.command()
@drive_options
def server(
    options: BusOptions,
    config: Config = "dbw-kit.toml",
    linger: Annotated[float, typer.Option(help="End when no client has been there for so long (s).")] = 60.0,
) -> None:
    """The process that owns the bus. `steerkit drive --car` and `learn --car` start one where there is none."""
    raise typer.Exit(processes.server(config, **vars(options), linger=linger))


@app.command()
@drive_options
def calibrate(
    options: CarOptions,
    config: Annotated[str, typer.Argument(help="TOML file of the car, or a shipped one.")] = "dbw-kit.toml",
    out: Annotated[FilePath | None, typer.Option(help="Vehicle file to write; default: NAME-calibrated.toml.")] = None,
    minutes: Annotated[float, typer.Option(help="How long to drive, engaged (0.1 to 60).")] = 4.0,
    controller: Annotated[str, typer.Option(help="Who keeps the car on its course.")] = "stanley",
    source: Annotated[
        FilePath | None, typer.Option("--from", help="Make the file from this recording; nothing is driven.")
    ] = None,
) -> None:
    """A guided drive that ends in a vehicle file: delay, lag, ratio, offset and friction, with intervals.

    The car follows its course while the wheel swings slowly, then steps to and fro, then is left to the bends. Engage
    by `e`, let go by space, as in any drive. Exit code: 0; 1 when nothing was found, or a car server runs already.
    """
    place = out or FilePath(f"{FilePath(config).stem}-calibrated.toml")
    with contextlib.redirect_stdout(sys.stderr) if options.as_json else contextlib.nullcontext():
        try:
            if source is not None:
                calibration.check_place(place)
                figures = calibration.from_recording(source, place, say=not options.quiet)
            else:
                figures = calibration.calibrate(car_options(options, config), place, base=controller, minutes=minutes)
        except calibration.NothingLearned as error:
            print(error, file=sys.stderr)
            raise typer.Exit(1) from None
    if options.as_json:
        print(json.dumps(figures))


@app.command()
def order(
    word: Annotated[str, typer.Argument(help="ARM, ENGAGE, DISENGAGE, ACKNOWLEDGE or OFF.")], socket: Socket = ""
) -> None:
    """Give the car server an order from a second terminal, whatever the controller is doing."""
    given = Order(known(word.upper(), Order, "order"))
    with CarClient(socket or processes.default_socket(), controller=False) as link:
        link.order(given)
        snapshot = link.query()
        for why in link.refused:
            print(f"refused: {why}")
        print(f"{snapshot.mode}: {snapshot.text}")
        raise typer.Exit(1 if link.refused else 0)


@app.command()
def stream(
    where: Annotated[str, typer.Argument(metavar="[HOST:]PORT", help="The loopback, unless a host is named.")] = "8765",
    socket: Socket = "",
) -> None:
    """Show a car live in Foxglove, from a second terminal, until Ctrl-C: a read-only WebSocket.

    It asks the car server as the panel does, and gives no orders; nothing on the car waits for it.
    """
    with CarClient(socket or processes.default_socket(), controller=False) as link:
        server = Server(where)
        print(f"live in Foxglove: open a connection to {server.address}; Ctrl-C ends it", flush=True)
        try:
            show(link, server)
        except CarLost as error:
            print(error)
        except KeyboardInterrupt:
            print("ended; the car goes on without it")
        server.end()


@app.command()
def replay(
    file: Annotated[FilePath, typer.Argument(help="A recording, .mcap.")],
    controller: Annotated[str, typer.Option(help="Replay through this one, instead of those who steered.")] = "",
    run: Annotated[str, typer.Option(help="Directory of the learning run, if it has moved.")] = "",
) -> None:
    """Look into a recording, and replay it: are the commands the same, bit for bit?

    Of one that is damaged, cut short, or still being written, what is intact so far is read. Exit code: 0; 1 when
    messages are missing, 2 when a replay lacks something.
    """
    recorded = recordings.read(file)
    print(recorded.kept())
    for line in [*recorded.lost, *(str(gap) for gap in recorded.gaps if gap.missing == 0)]:
        print(f"  {line}")
    for v in recorded.of("/state"):
        print(f"  {v['t']:.3f} s  {v.get('from')} -> {v.get('to')}: {v.get('cause')}")
    config = recordings.config_of(recorded)
    for difference in recordings.differences(recorded, config):
        print(f"not as it was then: {difference}")
    if any(gap.missing for gap in recorded.gaps):
        print("what follows missing messages may replay differently")
    frames, same = recordings.replayed_exactly(recorded, Core(config))
    print(f"server: {same} of {frames} frames the same")
    lacking = False
    for drive in replays.drives(recorded):
        asked, who = len(drive.requests), controller or drive.who
        try:
            same = replays.replayed_requests(drive, config, controller=controller, run=run)
            print(f"{who}: {same} of {asked} requests the same")
        except ValueError as error:
            lacking = True
            print(f"{who}: {asked} requests cannot be replayed: {error}")
        estimators, again = replays.replayed_estimates(drive, config)
        if drive.estimates:
            print(f"estimates: {again} of {len(drive.estimates)} the same")
        doubt = [estimates.DOUBTED] if estimators.doubted else []
        for line in [*estimates.report(estimators.found(), estimates.earlier(config)), *doubt]:
            print(f"  {line}")
    raise typer.Exit(2 if lacking else 1 if recorded.lost else 0)
