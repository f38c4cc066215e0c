"""Learning, end to end: both action sets learn on the same code; a car that changes on the way is learned anew."""

from benchmarks.run.changes import exchange
from steerkit.diagram.simulation import Log
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.settings import BANG_BANG, DEFAULT, Setting
from steerkit.metrics import of_log
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate

SCENARIO = Scenario(course="calibration")  # 262 m, bends of 17 m to either side


def learned(setting: Setting) -> tuple[LearningRun, Log]:
    """A run until its first whole round (in 11 minutes at most), and a quarter of one with its last policy."""
    run = learn(Experiment(setting=setting, scenario=SCENARIO, minutes=11.0, rounds=1, seed=5))
    return run, evaluate.drive(SCENARIO, run.policy, doe=setting.element(), seed=7, rounds=0.25, only_while_held=True)


def test_both_learn_a_whole_round_from_nothing_and_the_integrating_element_is_smoother() -> None:
    runs = {"i-doe": learned(DEFAULT), "bang-bang": learned(BANG_BANG)}
    first, rough_first = (run.counts.episodes[0] for run, _ in runs.values())
    assert first.began > 4.0
    assert first.net == 1
    assert rough_first.failed
    assert rough_first.ended is not None
    assert rough_first.ended - rough_first.began < 5.0  # it knew nothing
    for name, (run, _) in runs.items():
        assert run.counts.first_round_done is not None, name
        assert run.counts.episodes[-1].distance >= SCENARIO.path().length, name
        # every failure was caught, and the learner has the wheel at the end
        assert run.counts.failures == len(run.counts.episodes) - 1, name
    smooth, rough = (of_log(log) for _, log in runs.values())
    assert smooth.rms_wheel_rate_deg < 0.5 * rough.rms_wheel_rate_deg
    assert smooth.rms_jerk < rough.rms_jerk


def test_a_car_whose_delay_grows_in_mid_drive_is_found_under_recovery_and_learned_anew() -> None:
    """The learner fails at once (it drives on through a change to 0.4 s); the recovery was told the old delay."""
    scenario = Scenario(course="random-71", steering={"delay": 0.1})
    run = LearningRun(Experiment(scenario=scenario, minutes=3.0, seed=1))
    while run.t < 15.0:
        run.drive()
    exchange(run, scenario.with_(steering={"delay": 0.5}))
    failures, good = run.counts.failures, 0
    while good < 100 and not run.done():
        run.drive()
        good = good + 1 if run._value("supervisor.learning") > 0.5 and abs(run._value("path.e")) < 0.1 else 0
    assert run.counts.failures > failures
    assert good == 100  # five seconds
    assert 9 <= run.policy.forecast.samples <= 12
    assert (~run.transitions.own).sum() > 100
