"""How blocks, loops and logs look in a notebook: tables in HTML, pictures made only when they are shown."""

from __future__ import annotations

import base64
import dataclasses
import io
import reprlib
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.plots.style import save

if TYPE_CHECKING:
    from steerkit.diagram.block import Block
    from steerkit.diagram.simulation import Log

_SHOWN = ("e", "delta_sw", "v", "a_y", "psi_e", "r")  # outputs worth a panel, best first
_PANELS = 4
_SHORT = reprlib.Repr()
_SHORT.maxtuple, _SHORT.maxstring, _SHORT.maxother = 8, 90, 90


def block_html(block: Block) -> str:
    """Parameters and ports of a block, each with its unit or value."""
    summary = (type(block).__doc__ or "").strip().split("\n")[0]
    parameters = [(f.name, _SHORT.repr(getattr(block, f.name))) for f in dataclasses.fields(block)]
    ports = [
        (port.name, "in", port.unit, "seen by output and update" if port.direct else "seen by update only")
        for port in block.inputs
    ]
    for out in block.outputs:
        ways = ", ".join(p.name for p in (block.inputs if out.direct is None else out.direct) if p.direct)
        ports.append((out.name, "out", out.unit, f"of this sample's {ways}" if ways else "of the state"))
    return (
        f"<div><b>{type(block).__name__}</b> <span style='opacity:.7'>{escape(summary)}</span>"
        + _table(("parameter", "value"), parameters)
        + _table(("port", "", "unit", "feedthrough"), ports)
        + "</div>"
    )


def log_html(log: Log) -> str:
    """The range of every signal, and the most telling ones over time."""
    rows = []
    for name, values in log.signals.items():
        size = "" if values.ndim == 1 else " x ".join(map(str, values.shape[1:]))
        numbers = (np.min(values), np.mean(values), np.max(values)) if values.size else ()
        rows.append((name, log.units[name], size, *(f"{x:.4g}" for x in numbers)))
    span = f"{log.t[0]:g} to {log.t[-1]:g} s" if len(log.t) else "no time"
    head = f"<div><b>Log</b> {len(log.t)} samples, {span}"
    picture = ""
    if len(log.t) > 1:
        data = base64.b64encode(png(log.plot(*telling(log)), dpi=80)).decode()
        picture = f"<img alt='signals over time' src='data:image/png;base64,{data}'>"
    return f"{head}{picture}{_table(('signal', 'unit', 'size', 'min', 'mean', 'max'), rows)}</div>"


def telling(log: Log) -> list[str]:
    """Up to four signals, of different names, that tell most about a drive; else the first ones."""
    chosen = []
    for name in _SHOWN:
        chosen += [signal for signal in log if signal.rpartition(".")[2] == name and log[signal].size][:1]
    return chosen[:_PANELS] or [signal for signal in log if log[signal].size][:_PANELS]


def png(figure: Any, dpi: int = 110) -> bytes:
    """A matplotlib figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    save(figure, stream, format="png", dpi=dpi)
    return stream.getvalue()


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    cells = ["".join(f"<td style='text-align:left'>{escape(str(cell))}</td>" for cell in row) for row in rows]
    if not cells:
        return ""
    top = "".join(f"<th style='text-align:left'>{escape(name)}</th>" for name in head)
    return f"<table><tr>{top}</tr>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"
