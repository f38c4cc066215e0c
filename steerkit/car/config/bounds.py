"""How far each limit of a car's file may go, to both sides: a limit too tight ends every drive, one too wide none."""

from __future__ import annotations

from steerkit.task import STOP_DEG

BOUNDS: dict[str, tuple[float, float]] = {
    # the gate
    "delta_sw_max_deg": (5.0, STOP_DEG),
    "rate_max_deg": (10.0, 1000.0),
    "a_y_max": (0.2, 5.0),
    "jerk_max": (0.2, 10.0),
    "v_floor": (0.5, 5.0),
    "v_max": (0.5, 40.0),
    "dt_min": (0.004, 0.02),
    "dt_max": (0.02, 0.1),
    # ages and times [s]
    "report_age": (0.02, 0.15),
    "pose_age": (0.02, 0.15),
    "request_age": (0.052, 0.09),
    "request_lost": (0.06, 0.3),
    "lateness": (0.005, 0.1),
    "echo_age": (0.03, 0.5),
    "follow_time": (0.1, 2.0),
    "enable_time": (0.05, 2.0),
    "heartbeat": (0.15, 0.5),
    "still_time": (0.2, 5.0),
    "foreign_enable": (0.1, 1.0),
    "end_warning": (1.0, 20.0),
    # counts
    "torque_reports": (1, 10),
    "integrity_errors": (1, 10),
    "misses": (1, 20),
    # sizes
    "e_max": (0.1, 5.0),
    "e_growth": (0.2, 2.0),
    "e_engage": (0.05, 2.0),
    "psi_e_engage_deg": (1.0, 60.0),
    "psi_e_max_deg": (5.0, 90.0),
    "delta_engage_deg": (1.0, 90.0),
    "follow_angle_deg": (5.0, 120.0),
    "v_mismatch": (0.1, 3.0),
    "v_reverse": (0.05, 1.0),
    "v_still": (0.05, 1.0),
    "v_engage_min": (0.1, 20.0),
    "v_engage_max": (0.2, 40.0),
    "torque_max": (0.3, 10.0),
    "quality": (0.5, 100.0),
    "end_margin": (0.5, 50.0),
    # dead reckoning
    "pose_jump": (0.05, 0.5),
    "motion_along": (0.005, 0.15),
    "motion_across_deg": (0.1, 3.0),
    "heading_slack_deg": (0.5, 5.0),
    "heading_rate_deg": (0.05, 2.0),
    "wheel_slack_deg": (1.0, 10.0),
    "wheel_rate_deg": (0.5, 8.0),
    "wheel_share": (0.05, 0.8),
}
"""(smallest, largest) that `[limits]` may ask for, in the file's units."""
