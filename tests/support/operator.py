"""An operator who engages whenever it is possible, until nobody answers: `python -m tests.support.operator SOCKET`."""

import sys
import time
from contextlib import suppress
from pathlib import Path

from steerkit.car.client import CarClient, CarLost
from steerkit.car.state_machine import Order


def main(socket: str) -> None:
    """Acknowledge and engage, once a second."""
    end = time.monotonic() + 120.0
    while not Path(socket).exists() and time.monotonic() < end:
        time.sleep(0.1)
    time.sleep(0.1)
    with suppress(CarLost), CarClient(socket, controller=False, timeout=30.0) as link:
        while link.query():
            link.order(Order.ACKNOWLEDGE)
            link.order(Order.ENGAGE)
            time.sleep(1.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
