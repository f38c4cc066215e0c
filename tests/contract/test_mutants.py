"""The mutants that tests.support.mutants draws, and whether a test that notices one is found."""

from pathlib import Path

import pytest

from tests.support.mutants import Copies, Mutant, covering, drawn, mutants
from tests.support.places import ROOT

UNITS = "steerkit/diagram/units.py"
sources = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="runs in a checkout; here steerkit is installed")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("x = a + b", ["x = a - b"]),
        ("x = (a)  <  (b)", ["x = (a)  <=  (b)", "x = (a)  >=  (b)"]),
        ("x = a is  not b", ["x = a is b"]),
        ("ü = 'ü', not a", ["ü = 'ü', (a)"]),
        ("x: float = -2.0", ["x: float = (2.0)", "x: float = -3.0"]),
        ("x: str = 'mean'", ["x: str = 'not_mean'"]),
        ("x += 0 or y", ["x -= 0 or y", "x += 0 and y", "x += 1 or y"]),
        ("x = a if b else c", ["x = a if (not (b)) else c"]),
        ("def f(): return x", ["def f(): return None"]),
        (
            "require(a < b, where, f'{c + 1}')",
            ["require(a <= b, where, f'{c + 1}')", "require(a >= b, where, f'{c + 1}')"],
        ),
        ("raise ValueError(a + b)", []),
        ("x: int | None = None", []),
        ("def f(): '''1 + 1'''", []),
    ],
)
def test_each_is_one_change_and_what_no_test_should_see_is_left_alone(line: str, expected: list[str]) -> None:
    source = f"{line}\n".encode()
    assert [mutant.applied(source).decode().rstrip() for mutant in mutants("m.py", source)] == expected


@sources
def test_a_seed_draws_the_same_on_the_lines_and_under_the_folders_asked_for() -> None:
    first, again = (drawn(None, ["steerkit/diagram"], 20, 7) for _ in range(2))
    assert first == again != drawn(None, ["steerkit/diagram"], 20, 8)
    assert {Path(mutant.file).parent for mutant in first} == {Path("steerkit/diagram")}
    lines = {UNITS: {first_line.line for first_line in mutants(UNITS, (ROOT / UNITS).read_bytes())}}
    assert {mutant.file for mutant in drawn(lines, [], 20, 0)} == {UNITS}


@sources
def test_the_nearest_test_runs_first_and_an_unnoticed_mutant_survives(tmp_path: Path) -> None:
    assert covering(UNITS)[0] == "tests/unit/diagram/test_units.py"
    source = (ROOT / UNITS).read_bytes()
    start = source.index(b"return")
    broken = Mutant(UNITS, 1, start, "return", "return 7.0 +")
    copies = Copies(tmp_path, 1, 300.0)
    caught = copies.judged(broken, ["tests/unit/diagram/test_units.py"])
    assert (caught.outcome, caught.test.split("::")[0]) == ("caught", "tests/unit/diagram/test_units.py")
    assert copies.judged(broken, ["tests/unit/_support/test_clock.py"]).outcome == "survived"
