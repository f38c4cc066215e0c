"""The suites hang together, and go where a user has them go."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.entries import CONTROLLERS, controller
from benchmarks.foreign_cars import CARS
from benchmarks.peers import agents as peers
from benchmarks.report.verdict import ENOUGH
from benchmarks.run.provenance import provenance
from benchmarks.run.runner import run
from benchmarks.run.trainings import TRAININGS
from benchmarks.scenarios import facts, scene
from benchmarks.suites import SUITES, Suite, elsewhere, jobs, suite
from steerkit.learning.settings import SETTINGS
from tests.support.own_controller import own_controller
from tests.support.yard import yard


def test_suites_hang_together() -> None:
    for one in map(suite, SUITES):
        planned = jobs([one])
        assert len({job.id for job in planned}) == len(planned)
        for scenario in one.scenarios:
            assert scenario.path().length > 10.0
        for name in one.controllers:
            learner = controller(name)
            assert (learner.make is None) == learner.learns
            assert not learner.learns or learner.setting in {*SETTINGS, *peers.SETTINGS}
            assert learner.training in TRAININGS
        drives = [job for job in planned if job.kind == "drive"]
        needed = {job.training for job in drives if CONTROLLERS[job.controller].kind == "learned"}
        assert needed <= {job.id for job in planned if job.kind == "learn"}
    foreign = suite("foreign").scenarios
    assert len({scenario.name for scenario in foreign}) == len(foreign) == 2 * len(CARS)
    assert {scenario.believed_dead_time for scenario in foreign} == {0.0}, "they tell nothing"
    both = jobs([suite("paper"), suite("tracking")])
    assert sum(job.kind == "learn" for job in both) == 60  # shared, not learned twice
    assert len(jobs([suite("tracking")], 1)) == 3 + 14 * 10
    assert suite("quick").seeds >= ENOUGH, "for its verdict"
    assert {job.scenario for job in jobs([suite("tracking")], only=["slalom-9"])} == {"slalom-9", "train-clean"}


def test_a_suite_goes_elsewhere_where_it_has_no_course_or_car_of_its_own(tmp_path: Path) -> None:
    tracking = elsewhere(suite("tracking"), course=str(yard(tmp_path)), vehicle="bmw-320i", controllers=("a.py:make",))
    by_name = {scenario.name: scenario for scenario in tracking.scenarios}
    assert by_name["paper-round-on-yard-with-bmw-320i"].course.name == "yard.csv"
    assert by_name["slalom-9-with-bmw-320i"].course.name == "slalom"
    assert by_name["slalom-multi-body"].vehicle.name == "bmw-320i"
    assert tracking.controllers[-1] == "a.py:make"
    assert elsewhere(suite("golden")) == suite("golden")
    with pytest.raises(ValueError, match="suite 'golden': every scenario has a course and a car of its own"):
        elsewhere(suite("golden"), course="genesis")


def test_a_controller_of_ones_own_drives_a_suite_and_a_changed_file_is_not_mixed_in(tmp_path: Path) -> None:
    name = own_controller(tmp_path)
    agent = name.replace(":make", ":agent")  # a policy with its output element
    one = replace(suite("golden"), scenarios=suite("golden").scenarios[1:], controllers=("stanley", name, agent))
    kept = run([replace(one, controllers=("stanley",))], tmp_path / "results", seeds=1, workers=1, quiet=True)
    results = run([one], tmp_path / "results", seeds=1, workers=1, only=["my_file"], quiet=True)
    assert {case.controller: case.metrics["held"] for case in results.cases} == {"stanley": 1.0, name: 1.0, agent: 1.0}
    assert kept.cases[0] in results.cases  # beside it, and not driven anew
    assert results.provenance["controllers"][name]["kind"] == "own"
    assert "SHA-256" in results.provenance["controllers"][name]["about"]
    file = tmp_path / "my_file.py"
    file.write_text(file.read_text().replace("2.5", "2.6"))
    with pytest.raises(ValueError, match=r"results of another controller .*my_file.py:make"):
        run([one], tmp_path / "results", seeds=1, workers=1, quiet=True)


def test_on_cars_unlike_their_data_sheet_a_learner_is_trained_for_each() -> None:
    planned = jobs([suite("adapt")], 1)
    trained = [job for job in planned if job.kind == "learn"]
    assert len(trained) == len({job.id for job in trained}) == 2 * len(suite("adapt").scenarios)
    assert {job.training for job in planned if job.kind == "drive" and "nfq" in job.controller} == {
        job.id for job in trained
    }
    quick = suite("adapt-quick")
    (car,) = quick.scenarios
    protocol = provenance([quick], jobs([quick]), None)["scenarios"]
    taught = protocol[f"train-same-car-1-on-{car.name}"]
    assert taught | {"knowledge.delay": 0.0, "knowledge.lag": 0.0} == (
        protocol[car.name] | {key: value for key, value in taught.items() if key not in facts(car)}
    )


def test_a_drive_without_chance_is_planned_once_and_one_with_it_for_every_seed() -> None:
    steady = scene(name="steady", course="circle", driver={"v_min": 6.0, "v_max": 6.0})
    chances = (steady.with_(name="wander", driver={"v_max": 7.0}), steady.with_(name="noise", sensors={"noise": 1.0}))
    chances += (steady.with_(name="gust", disturbances={"gust": 0.1}),)
    one = Suite(name="x", about="", scenarios=(steady, *chances), controllers=("stanley",), seeds=4)
    for asked, seeds in ((None, 4), (7, 7)):
        planned = [job.scenario for job in jobs([one], asked)]
        assert planned.count("steady") == 1
        assert all(planned.count(scenario.name) == seeds for scenario in chances)
    learned = jobs([replace(one, scenarios=(steady,), controllers=("nfq-idoe",))])
    assert [job.kind for job in learned].count("drive") == 4  # its net is another one for each seed
