"""Production cars for tests: behind their port, judged by opendbc's safety code in C."""

from typing import Any

import pytest

pytest.importorskip("opendbc")

from benchmarks.judges.opendbc_safety import SafetyJudge
from benchmarks.run.production import PortedCar, config_of
from steerkit._support import native
from steerkit.car.production.platforms import platform

judged = pytest.mark.skipif(native.compiler() is None, reason="opendbc's safety code is C, and there is no compiler")
EACH = (
    *("TESLA_MODEL_3", "FORD_MUSTANG_MACH_E_MK1", "FORD_FOCUS_MK4", "NISSAN_LEAF", "NISSAN_ALTIMA", "TOYOTA_COROLLA"),
    *("TOYOTA_RAV4_TSS2_2023", "HONDA_CIVIC_BOSCH", "HONDA_CIVIC", "HYUNDAI_ELANTRA_2021", "HYUNDAI_IONIQ_5"),
    *("VOLKSWAGEN_GOLF_MK7", "VOLKSWAGEN_PASSAT_NMS", "SUBARU_OUTBACK", "SUBARU_IMPREZA", "MAZDA_CX5_2022"),
    *("CHRYSLER_PACIFICA_2020", "RAM_1500_5TH_GEN", "CHEVROLET_BOLT_EUV", "RIVIAN_R1"),
)
"""A platform of each maker and each kind of its frames."""


def ported(name: str, **more: Any) -> PortedCar:
    """On the highway, by hand: its wheel is never quite straight."""
    return PortedCar(config_of(name), judge=SafetyJudge(platform(name)), s=10.0, **more)


def steered(car: PortedCar, seconds: float, delta_sw: float = 0.0, *, enable: bool = True) -> None:
    """For so long, with a command each 20 ms."""
    writer = car.config.writer
    for _ in range(round(seconds / 0.02)):
        t = car.due + 0.01
        car.receive(t, writer.message.frame_id, writer.write(delta_sw, enable=enable))
        car.advance(t)
