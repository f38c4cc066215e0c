"""All attacks at all speeds, as the Markdown of docs/real-car.md: `python -m tests.attack.table [--jobs 2]`."""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor

from tests.attack.attacks import ATTACKS
from tests.attack.bench import Drive
from tests.attack.test_attacks import SPEEDS


def row(name: str) -> str:
    """One attack: the end at each speed, the worst true excess of |e| and a_y, and what was said."""
    attack = ATTACKS[name]
    drives = [Drive(attack, speed=speed).run() for speed in SPEEDS]
    ends = [f"{1e3 * d.silence():.0f}" if math.isfinite(d.ended()) else "drives on" for d in drives]
    cause = next((d.cause() for d in drives if d.cause()), attack.physics or "-")
    good = all(
        d.engaged_at_onset()
        and d.excess() <= attack.excess_max
        and d.a_y() <= attack.a_y_max
        and not d.bus_faults()
        and (math.isfinite(d.ended()) or attack.harmless or attack.physics)
        for d in drives
    )
    worst, a_y = max(d.excess() for d in drives), max(d.a_y() for d in drives)
    said = cause.split(": ", 1)[0] if attack.physics else cause.split(", last: ")[-1].split(": ")[0]
    return f"| {name} | {' | '.join(ends)} | {worst:.2f} | {a_y:.2f} | {said} |{'' if good else ' **MISSED** |'}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--only", default="", help="attacks with this in their name")
    options = parser.parse_args()
    speeds = " | ".join(f"silence at {speed:g} m/s [ms]" for speed in SPEEDS)
    print(f"| attack | {speeds} | worst excess of true e [m] | worst true a_y [m/s²] | noticed as |")
    print(f"|---|{'---|' * (len(SPEEDS) + 3)}")
    with ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(row, [name for name in ATTACKS if options.only in name]):
            print(line, flush=True)


if __name__ == "__main__":
    main()
