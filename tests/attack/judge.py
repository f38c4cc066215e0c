"""What has to hold in every attacked drive, judged by the true car and the bus."""

from __future__ import annotations

import math

from tests.attack.bench import Drive


def complaints(drive: Drive, harmless: float = 0.25) -> list[str]:
    """What was not as it should be; nothing, if all was.

    harmless: how much further off the path an attack may bring the car that needs no answer [m].
    """
    attack, found = drive.attack, drive.bus_faults()
    if not drive.engaged_at_onset():
        found.append(f"not engaged at the onset: {drive.core.obstacles()}")
    if not drive.excess() <= attack.excess_max:
        found.append(f"{drive.excess():.2f} m further off the path ({drive.cause()})")
    if not drive.a_y() <= attack.a_y_max:
        found.append(f"a_y {drive.a_y():.2f} m/s^2")
    unnoticed = math.isinf(drive.ended())
    if unnoticed and not (attack.harmless or attack.physics):
        found.append("went unnoticed")
    if unnoticed and attack.harmless and not drive.excess() < harmless:
        found.append(f"not as harmless as it was thought to be: {drive.excess():.2f} m")
    return found
