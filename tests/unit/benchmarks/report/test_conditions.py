"""The map of failures is the grid that was driven."""

import numpy as np

from benchmarks.report import conditions
from benchmarks.run.results import Results


def test_the_failure_map_is_the_grid_that_was_driven(known: Results) -> None:
    cases = [c for c in known.cases if c.suite == "robustness"]
    (grid,) = conditions.grids(cases, known.protocol)
    assert {grid.x, grid.y} == {"v", "steering.delay"}
    assert (grid.xs, grid.ys) == ((4.0, 6.0, 9.0), (0.3, 0.2, 0.1, 0.0))
    for name, shares in grid.shares.items():
        for i, delay in enumerate(grid.ys):
            for j, v in enumerate(grid.xs):
                here = [c for c in cases if c.controller == name and c.scenario == f"delay {delay:g} v {v:g}"]
                assert shares[i, j] == np.mean([c.metrics["held"] for c in here])
    assert grid.shares["pure-pursuit"][0, 2] == 0.0
    assert conditions.grids([c for c in known.cases if c.suite == "tracking"], known.protocol) == []


def test_a_place_that_nobody_drove_is_not_called_lost_and_one_condition_alone_is_no_map(known: Results) -> None:
    cases = [c for c in known.cases if c.suite == "robustness"]
    gone = ("pure-pursuit", "delay 0.3 v 9")
    (grid,) = conditions.grids([c for c in cases if (c.controller, c.scenario) != gone], known.protocol)
    assert np.argwhere(np.isnan(grid.shares["pure-pursuit"])).tolist() == [[0, 2]]
    assert not np.isnan(grid.shares["stanley"]).any()
    assert conditions.grids([c for c in cases if c.scenario.endswith(" v 6")], known.protocol) == []
