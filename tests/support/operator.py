"""A command on a car, and an operator who engages whenever it is possible, until nobody answers:

    python -m tests.support.operator SOCKET car calibrate my-car.toml --simulated

Ends as the command does, but with 0 where that only found that there was too little driving (1).
"""

import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from steerkit.car.client import CarClient, CarLost
from steerkit.car.state_machine import Order


def main(socket: str, *words: str) -> int:
    """Start it; acknowledge and engage, once a second."""
    command = subprocess.Popen([sys.executable, "-m", "steerkit", *words, "--socket", socket])
    end = time.monotonic() + 120.0
    while not Path(socket).exists() and time.monotonic() < end:
        time.sleep(0.1)
    time.sleep(0.1)
    with suppress(CarLost), CarClient(socket, controller=False, timeout=30.0) as link:
        while link.query():
            link.order(Order.ACKNOWLEDGE)
            link.order(Order.ENGAGE)
            time.sleep(1.0)
    code = command.wait()
    return 0 if code == 1 else code


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
