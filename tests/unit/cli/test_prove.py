"""`steerkit prove`: JSON, the exit code, limits of one's own, a log; its mistakes: test_app.py."""

from pathlib import Path
from typing import Any

LIMITS = '[[limit]]\nquantity = "yaw_delay"\nhigh = {high}\nsource = "ours"\n'


def test_a_manoeuvre_is_judged_by_a_user_s_limits_and_the_exit_code_says_so(tmp_path: Path, cli: Any) -> None:
    for high, passed in ((0.3, True), (0.01, False)):
        (tmp_path / "limits.toml").write_text(LIMITS.format(high=high))
        words = ("step-steer", "--limits", tmp_path / "limits.toml", "--json")
        (found,) = cli("prove", *words, code=0 if passed else 1).json["evaluations"]
        assert found["passed"] is passed
        assert found["results"]["yaw_delay"]["unit"] == "s"
        assert found["unverified"]
    words = ("sine-with-dwell", "--vehicle", "bmw-320i", "--limits", tmp_path / "limits.toml")
    assert cli("prove", *words, code=0).out.count("not evaluated") == 1, "no delay is told by a sine with dwell"


def test_a_log_is_searched_and_several_manoeuvres_get_a_page_each(tmp_path: Path, cli: Any) -> None:
    words = ("steady-state-circle", "sine", "--car", "genesis", "--report", tmp_path / "pages", "--json")
    steady, sine = cli("prove", *words).json["evaluations"]
    assert steady["results"]["understeer_gradient"]["n"] > 30
    assert sine["runs"] == []
    assert any("not in this log" in note for note in sine["notes"])
    assert {file.name for file in (tmp_path / "pages").iterdir()} == {"steady-state-circle.html", "sine.html"}
