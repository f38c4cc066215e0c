"""A loop as an FMU for co-simulation (FMI 2.0), through PythonFMU (extra `export`).

The FMU holds the loop as straight-line Python (`steerkit.compiled`): where it runs it needs a Python 3.9 or newer, as
all FMUs of PythonFMU do, but neither steerkit nor NumPy.
"""

import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from steerkit._support.errors import optional, require
from steerkit.compiled.graph import FUNCTIONS
from steerkit.compiled.python_code import PythonProgram
from steerkit.compiled.trace import Trace, parameter, trace
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Signal
from steerkit.export.c import from_template


def export_fmu(
    loop: Loop, file: str | os.PathLike[str], *, outputs: Sequence[Signal], parameters: Sequence[str] = ()
) -> Path:
    """Write a loop as an FMU whose outputs are these signals; returns its path.

    parameters: block fields such as `controller.k` that become tunable parameters, under their names. The master may
    step as it likes: the loop takes its own samples, each loop.dt, and outputs hold their values between them. It can
    be saved and restored (FMU state), and gives the numbers of `simulate`.

    Raises TraceError for a loop that cannot be compiled, KeyError for an unknown signal, ValueError for a vector signal
    or a file name that is no identifier with the ending .fmu.
    """
    target = Path(file)
    fits = target.suffix == ".fmu" and re.fullmatch(r"[A-Za-z]\w*", target.stem)
    require(fits, "export_fmu", f"file {target.name!r}, expected letters, digits and _, and the ending .fmu")
    builder = optional("pythonfmu.builder", "export_fmu", "export").FmuBuilder
    program = trace(loop, parameters=parameters)
    names = [signal if isinstance(signal, str) else loop.port_name(signal) for signal in outputs]
    for name in names:
        loop.locate(name)
        require(program.layout.signals[name][1] is None, "export_fmu", f"{name} is a vector; expected scalar signals")
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder, f"{target.stem.lower()}_model.py")
        script.write_text(_script(program, target.stem, names, parameters), encoding="utf-8")
        builder.build_FMU(script, target, canGetAndSetFMUstate="true", canSerializeFMUstate="true")
    return target


def _script(program: Trace, name: str, outputs: Sequence[str], parameters: Sequence[str]) -> str:
    loop, layout = program.loop, program.layout
    start = loop.init()
    slots = [float(value) for value in layout.pack(start.x, start.y)]
    fixed = {n: float(parameter(loop, n)) for n in parameters}
    shown = {output: (layout.slots_of(output)[0], loop.units[output]) for output in outputs}
    tables = [np.array(table.rows).tolist() for table in program.tables]
    return "\n".join(
        [
            f"from math import inf, nan, {', '.join(sorted(FUNCTIONS))}",
            "from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real",
            *[f"table{i} = {rows!r}" for i, rows in enumerate(tables)],
            PythonProgram(program, range(len(layout)), 1).source,
            f"STEP, CARRIED, START = {loop.dt!r}, {program.persistent!r}, {slots!r}",
            f"AT_START = { {output: slots[slot] for output, (slot, _) in shown.items()}!r}",
            f"FIXED, OUTPUTS = {fixed!r}, {shown!r}",
            "",
            "",
            from_template("fmu_slave.py.in", name=name, description=repr(f"{loop!r}, made by steerkit")),
        ]
    )
