"""A program that starts warm is a process like one that starts cold: words, environment, streams, signals, its end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.places import ROOT

Words = tuple[str, ...]
SAYS = (
    "import json, os, sys; print(json.dumps([sys.argv[1:], os.getcwd(), os.environ.get('WORD'), sys.stdin.read(),"
    " [name for name in sys.modules if name.split('.')[0] == 'tests']]))"
)


def test_words_folder_environment_and_input_are_its_own(python: Words, tmp_path: Path) -> None:
    told = [
        subprocess.run(
            [*start, "-c", SAYS, "a b", "ü"],
            input="in",
            cwd=tmp_path,
            env={**os.environ, "WORD": "x"},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for start in (python, (sys.executable,))
    ]
    assert told[0] == told[1]
    assert json.loads(told[0]) == [["a b", "ü"], str(tmp_path), "x", "in", []]


@pytest.mark.parametrize(
    "code",
    [
        "import atexit; atexit.register(print, 'last'); print('first')",
        "import sys; sys.exit(3)",
        "import sys; sys.exit('why')",
        "raise ValueError('why')",
        "import os, signal; os.kill(os.getpid(), signal.SIGTERM)",
        "raise KeyboardInterrupt",
        "import os; os._exit(7)",
        "import threading, time; threading.Thread(target=lambda: (time.sleep(0.1), print('late'))).start()",
        "from multiprocessing import get_context as c; p = c('spawn').Process(target=print); p.start(); p.join()",
    ],
)
def test_it_ends_as_a_cold_one_does(code: str, python: Words) -> None:
    warm, cold = (
        subprocess.run([*start, "-c", code], capture_output=True, text=True) for start in (python, (sys.executable,))
    )
    assert (warm.returncode, warm.stdout) == (cold.returncode, cold.stdout)
    assert warm.stderr.splitlines()[-1:] == cold.stderr.splitlines()[-1:]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_a_signal_reaches_the_program(number: signal.Signals, python: Words) -> None:
    code = "import os, time; print(os.getpid(), flush=True); time.sleep(600)"
    with subprocess.Popen([*python, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        program = int(process.stdout.readline())
        assert program != process.pid
        process.send_signal(number)
        process.communicate(timeout=60.0)
    assert process.returncode == -number
    end = time.monotonic() + 60.0
    while Path(f"/proc/{program}").exists():
        assert time.monotonic() < end, "the program outlived its client"
        time.sleep(0.01)


def test_a_module_and_a_file_are_found_as_by_python(python: Words, tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("name = 'beside'\n")
    (tmp_path / "it.py").write_text("import sys, beside\nprint(__name__, beside.name, sys.argv)\n")
    for words in (("-m", "it", "x"), (str(tmp_path / "it.py"), "x")):
        warm, cold = (
            subprocess.run([*start, *words], cwd=tmp_path, capture_output=True, text=True)
            for start in (python, (sys.executable,))
        )
        assert (warm.stdout, warm.stderr) == (cold.stdout, cold.stderr)
        assert warm.stdout.startswith("__main__ beside")


def test_another_steerkit_on_the_search_path_is_the_one_that_is_imported(python: Words, tmp_path: Path) -> None:
    (tmp_path / "steerkit").mkdir()
    (tmp_path / "steerkit" / "__init__.py").write_text("name = 'another'\n")
    code = "import sys; print('steerkit' in sys.modules); import steerkit; print(steerkit.name, steerkit.__file__);"
    code += "print([name for name in sys.modules if name.startswith('steerkit.')])"
    done = subprocess.run(
        [*python, "-c", code],
        cwd="/",
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ["False", f"another {tmp_path / 'steerkit' / '__init__.py'}", "[]"]


def test_this_checkout_s_modules_are_there_already_and_run_as_programs_without_a_warning(python: Words) -> None:
    code = "import sys; print('steerkit.learning.learn' in sys.modules)"
    words = (("-c", code), ("-m", "steerkit.learning.learn"))
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    first, second = (subprocess.run([*python, *w], env=here, capture_output=True, text=True, check=True) for w in words)
    assert (first.stdout, first.stderr) == ("True\n", "")
    assert (second.stdout, second.stderr) == ("", "")
