"""For all tests: properties have no deadline, as a machine may be busy, and print what they failed on."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("steerkit", deadline=None, print_blob=True)
settings.load_profile("steerkit")
