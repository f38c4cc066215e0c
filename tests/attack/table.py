"""All attacks at all speeds, as a table in Markdown: `python -m tests.attack.table [--jobs 2]`, or `make attacks`.

With `--controllers mpc lqr ...` those of the product steer, and each has a column instead of each speed; with
`--ports TESLA_MODEL_3 ...` the car is that production car. `--liars`:
every lie that agrees with itself, with every controller (or those), at every speed, to two cars, calibrated and not:
2,160 drives.
"""

import argparse
import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from tests.attack.attacks import ATTACKS, LIARS, OF_A_KIT
from tests.attack.bench import SPEEDS, Drive, driven, through_port
from tests.attack.product import CONTROLLERS, HARMLESS, driven_by, lied_to, sooner


def row(name: str) -> str:
    """One attack: the end at each speed, the worst true excess of |e| and a_y, and what was said."""
    attack = ATTACKS[name]
    drives = [driven(attack, speed=speed) for speed in SPEEDS]
    ends = [f"{1e3 * d.silence():.0f}" if math.isfinite(d.ended()) else "drives on" for d in drives]
    cause = next((d.cause() for d in drives if d.cause()), "")
    worst, a_y = max(d.excess() for d in drives), max(d.a_y() for d in drives)
    said = cause.split(", last: ")[-1].split(": ")[0] or attack.physics or "-"
    missed = any(d.complaints() for d in drives)
    return f"| {name} | {' | '.join(ends)} | {worst:.2f} | {a_y:.2f} | {said} |{' **MISSED** |' if missed else ''}"


def compared(name: str, controllers: list[str], drive: Callable[..., Drive] = driven_by) -> str:
    """One attack: of each controller or port the latest silence, the worst excess of |e| and a_y, what was missed."""
    cells, wrong = [name], []
    for controller in controllers:
        drives = [drive(controller, ATTACKS[name], speed=speed) for speed in SPEEDS]
        ends = [f"{1e3 * d.silence():.0f}" for d in drives if math.isfinite(d.ended())]
        on = "on" if len(ends) < len(SPEEDS) else ""
        end = ", ".join([max(ends, key=int), on] if ends and on else [max(ends, key=int)] if ends else [on])
        cells.append(f"{end} / {max(d.excess() for d in drives):.2f} / {max(d.a_y() for d in drives):.2f}")
        wrong += [f"{controller} at {d.speed:g} m/s: {what}" for d in drives for what in d.complaints(HARMLESS)]
    return f"| {' | '.join(cells)} |{f' **MISSED** {wrong} |' if wrong else ''}"


def lies(name: str, controllers: Sequence[str]) -> str:
    """One liar, to cars that were calibrated and not: how many drives within 0.5 m, 1 m; the worst; what was said."""
    cells, wrong, unheld = [name], [], 0
    for known in (True, False):
        within, worst, soonest, drives = 0, 0.0, math.inf, 0
        for controller, speed, kinematic in itertools.product(controllers, SPEEDS, (False, True)):
            drive = lied_to(name, controller, speed, known=known, kinematic=kinematic)
            if not drive.engaged_at_onset():
                unheld += 1
                continue
            drives += 1
            within += drive.excess() <= (0.5 if known else 1.0)
            worst, soonest = max(worst, drive.excess()), min(soonest, drive.astray)
            if sooner(drive, known=known):
                who = f"{controller}, {speed:g} m/s, {known=}, {kinematic=}"
                wrong.append(f"{who}: {drive.reached(0.5):.2f} s, said {drive.astray:.2f} s, {drive.excess():.2f} m")
        cells += [f"{within} of {drives}", f"{worst:.2f}", f"{soonest:.2f}"]
    return f"| {' | '.join([*cells, str(unheld), str(len(wrong))])} |{f' **MISSED** {wrong}' if wrong else ''}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--only", default="", help="attacks with this in their name")
    parser.add_argument("--controllers", nargs="+", choices=CONTROLLERS, default=[], help="the product's own steer")
    parser.add_argument("--ports", nargs="+", default=[], help="production cars, by their names in opendbc")
    parser.add_argument("--liars", action="store_true", help="lies that agree with themselves, at all there is")
    options = parser.parse_args()
    line = partial(compared, controllers=options.controllers) if options.controllers else row
    names = list(ATTACKS)
    if options.liars:
        heads = ["calibrated: within 0.5 m", "worst excess [m]", "said: not 0.5 m off before [s]"]
        heads += ["not: within 1 m", *heads[1:], "not engaged", "sooner than said"]
        steering = options.controllers or ("own", *CONTROLLERS)
        line, names = partial(lies, controllers=steering), list(LIARS)
    elif options.ports:
        line = partial(compared, controllers=options.ports, drive=through_port)
        names = [name for name in ATTACKS if name not in OF_A_KIT]
        heads = [f"{name} [ms / m / m/s²]" for name in options.ports]
    elif options.controllers:
        heads = [f"{name} [ms / m / m/s²]" for name in options.controllers]
    else:
        heads = [*(f"silence at {speed:g} m/s [ms]" for speed in SPEEDS), "worst excess of true e [m]"]
        heads += ["worst true a_y [m/s²]", "noticed as"]
    print(f"| attack | {' | '.join(heads)} |")
    print(f"|---|{'---|' * len(heads)}")
    with ProcessPoolExecutor(options.jobs) as pool:
        for text in pool.map(line, [name for name in names if options.only in name]):
            print(text, flush=True)


if __name__ == "__main__":
    main()
