"""Cars by name."""

import pytest

from steerkit.vehicles import BMW_320I, VW_PASSAT, Vehicle, vehicle


def test_named_cars():
    assert vehicle("vw-passat") is vehicle("VW Passat") is vehicle("vw_passat") is VW_PASSAT
    assert isinstance(BMW_320I, Vehicle)
    assert VW_PASSAT.wheelbase == pytest.approx(2.71)
    with pytest.raises(ValueError, match=r"'pasat' is not known \(did you mean 'vw-passat'\?\); valid: vw-passat, bmw"):
        vehicle("pasat")
    with pytest.raises(ValueError, match="'zzz' is not known; valid: vw-passat"):
        vehicle("zzz")
