"""Driving seconds to a good driver: NFQ beside the sample-efficient agents of others, on one car."""

from __future__ import annotations

import argparse
from typing import Any

from rich.console import Console
from rich.table import Table


def add_options(parser: Any) -> None:
    """Which agents, how many seeds, and for how long."""
    parser.add_argument("--seeds", type=int, default=6, help="runs of each agent")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure, and print."""
    Console(width=120).print(Table("agent", "good share", "seconds", title="driving seconds to a good driver"))
    return {"good_seconds": {}, "good_share": {}}
