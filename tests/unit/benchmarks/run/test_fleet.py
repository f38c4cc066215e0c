"""Cars that nothing was tuned on."""

from benchmarks.run import fleet
from benchmarks.run.fleet import KINDS, of_kind


def test_every_kind_of_car_starts_where_it_is_straight_and_can_be_told_the_truth() -> None:
    for kind in KINDS:
        cars = of_kind(kind, course={"rounds": 0.5})
        assert len({car.name for car in cars}) == len(cars)
        for car in cars:
            assert car.course.rounds == 0.5
            assert abs(car.path().kappa(car.course.start)) < 0.01
            assert car.with_(knowledge={"oracle": True}).design_model().gain == car.steering.gain
    assert [car.steering.delay for car in of_kind("delays")] == list(fleet.DELAYS)
