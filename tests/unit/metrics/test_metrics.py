"""Importing the metrics stays light."""

from __future__ import annotations

import subprocess
import sys


def test_importing_the_metrics_does_not_load_scipy() -> None:
    code = "import sys, steerkit.metrics; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
