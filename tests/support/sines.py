"""Sines, whose metrics are known."""

from typing import Any

import numpy as np

T = np.arange(2001) * 0.05  # 100 s at 20 Hz


def sine(frequency: float, t: Any = T, amplitude: float = 1.0) -> Any:
    return amplitude * np.sin(2.0 * np.pi * frequency * t)
