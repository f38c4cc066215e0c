"""Vehicle files: broken ones teach."""

from pathlib import Path

import pytest

from steerkit.vehicles import vehicle, vehicle_text
from tests.support.recorded_cars import BASE


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x = ", "not TOML"),
        ('format = "steerkit vehicle 1"', r"no table \[vehicle\]"),
        (vehicle_text(BASE).replace("c_f", "# c_f"), r"\[vehicle\]: lacks c_f"),
        (vehicle_text(BASE).replace("c_f", "c_g"), r"\[vehicle\]: no key 'c_g' \(did you mean 'c_r'\?\)"),
        (vehicle_text(BASE) + "wings = 2.0\n", "no key 'wings'"),
        (vehicle_text(BASE).replace("m = 1639.0", "m = [1639.0]"), "m, expected numbers"),
        (vehicle_text(BASE).replace("m = 1639.0", "m = -1.0"), r"m = -1.0 \[kg\]"),
    ],
)
def test_a_broken_vehicle_file_teaches(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "car.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=says):
        vehicle(str(file))
    with pytest.raises(ValueError, match="cannot be read"):
        vehicle(str(tmp_path / "no.toml"))
