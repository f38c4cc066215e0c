"""What the paper reports, to be shown beside what was measured here.

Riedmiller, Montemerlo, Dahlkamp 2007, "Learning to Drive a Real Car in 20 Minutes". Its course, car and speeds are not
published in full: ours are like them, not the same, and no car was driven here.
"""

from __future__ import annotations

from typing import Any

_ROUND, _TRAIN = "paper-round", "train-clean"


def _value(figure: str, what: str, value: float, unit: str, metric: str, controllers: tuple[str, ...],
           scenario: str = _ROUND) -> dict[str, Any]:  # fmt: skip
    return {"figure": figure, "what": what, "value": value, "unit": unit, "metric": metric,
            "controllers": [*controllers], "scenario": scenario}  # fmt: skip


_BANG, _IDOE = ("nfq-paper-bang-bang", "nfq-bang-bang"), ("nfq-paper-idoe", "nfq-idoe")
PAPER_VALUES: list[dict[str, Any]] = [
    _value("3", "simulation, bang-bang: largest |e| over 2,000 steps", 0.25, "m", "max_e", _BANG),
    _value("3", "simulation, bang-bang: lateral acceleration up to", 8.0, "m/s^2", "max_a_y", _BANG),
    _value("4", "simulation, I-DOE: largest |e| over 2,000 steps, about", 0.1, "m", "max_e", _IDOE),
    _value("5", "car, I-DOE: driving time to the first whole round", 11.0, "min", "round_minutes", _IDOE, _TRAIN),
    _value("5", "car, I-DOE: episodes to the first whole round", 56.0, "1", "round_episodes", _IDOE, _TRAIN),
    _value("5", "car, I-DOE: transitions after 60 episodes, about", 20000.0, "1", "transitions", _IDOE, _TRAIN),
    _value("6", "car, I-DOE: largest |e| of the first round, below", 0.5, "m", "max_e", _IDOE),
]
"""What the paper says: its figure, what, the value, and the metric, scenario and controllers to show it beside."""
