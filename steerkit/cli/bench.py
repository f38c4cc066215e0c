"""`steerkit bench ...`: the benchmark suites and studies, which are the package `benchmarks` beside this one."""

from __future__ import annotations

from benchmarks.app import app

__all__ = ["app"]
