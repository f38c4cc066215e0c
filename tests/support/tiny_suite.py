"""A suite of a few seconds, and whether two runs of it agree."""

from benchmarks.run.compare import compare
from benchmarks.run.results import Results
from benchmarks.scenarios import scene
from benchmarks.suites import Suite

TINY = Suite(
    name="golden",  # a name that --help and the table know; fewer cases
    about="tests",
    scenarios=(scene(name="slalom", course="slalom", driver={"v_max": 9.0}),),
    controllers=("stanley", "stanley-textbook"),
    seeds=3,
)


def same(results: Results, reference: Results) -> None:
    found = compare(reference, results, rel=0.0, absolute=0.0)
    assert found.same, found
    assert found.compared >= 6 * 20
    for case in results.cases:
        one, two = results.trajectory(case), reference.trajectory(case)
        assert one is not None
        assert two is not None
        assert all((one[name] == two[name]).all() for name in one)
