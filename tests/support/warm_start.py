"""Programs that start at once: forked from an interpreter that has imported what they need already.

Tests start some three hundred programs, and most of a short one's time goes into NumPy, SciPy, Matplotlib, CasADi,
typer, and the classes of steerkit. `Warm` keeps one interpreter that has imported these; a program is a fork of it: a
process with arguments, environment, folder, input and output of its own, that ends with its own exit code. If its
search path leads to another steerkit than this checkout's, it imports that one. In place of `sys.executable` a test
gives `Warm.python`, a small client that hands all of this over, waits, and passes on signals; if it is killed, so is
the program. What must start cold (the time or the modules of a start, a terminal, another locale) goes on using
`sys.executable`. The processes among which pytest-xdist shares the tests are such programs too (tests/conftest.py).

    with Warm() as warm:
        subprocess.run([*warm.python, "-m", "steerkit", "drive", "stanley"])
"""

from __future__ import annotations

import array
import atexit
import contextlib
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from pathlib import Path
from typing import Any

PACKAGES = (
    *("numpy", "scipy.linalg", "scipy.optimize", "scipy.interpolate", "scipy.integrate", "scipy.signal", "scipy.stats"),
    *("matplotlib.figure", "matplotlib.pyplot", "matplotlib.backends.backend_agg", "PIL.PngImagePlugin"),
    *("PIL.GifImagePlugin", "PIL.JpegImagePlugin", "PIL.BmpImagePlugin", "PIL.PpmImagePlugin", "casadi", "control"),
    *("typer", "typer._adapters", "rich.console", "rich.table", "rich.progress", "rich._emoji_codes", "pydantic.main"),
    *("cantools", "can", "mcap.reader", "mcap.writer", "sqlite3", "tomllib", "asyncio", "http.server", "psutil"),
    *("multiprocessing.resource_tracker", "multiprocessing.shared_memory", "joblib", "pandas", "torch"),
)
"""What is imported beforehand; none of it starts a thread, but for one of pyarrow's allocator, which knows of forks."""
OURS = (
    *("steerkit.cli.app", "steerkit.learning.learn", "steerkit.learning.report", "steerkit.learning.trainer"),
    *("steerkit.plots.drive", "steerkit.learning.pictures.policy"),
    *("steerkit.controllers.mpc.block", "steerkit.plots.log", "steerkit.car.session", "steerkit.car.replay"),
    *("steerkit.logs.reading", "steerkit.identification", "benchmarks.app", "benchmarks.run.runner"),
)
"""Modules of this checkout, with all that they import; none of it asks environment, folder or terminal on import."""
SELDOM = (100_000, 50, 50)
"""How many new objects it takes for a look for garbage: as often as usual, it takes a sixth of the tests' time."""
CLIENT = Path(__file__).with_name("warm_client.py")


def command(socket: str) -> tuple[str, ...]:
    """What stands for `python`, of the interpreter behind that socket."""
    return (sys.executable, "-IS", str(CLIENT), socket)


class Warm:
    """The interpreter that programs are forked from, from `with` to its end."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="steerkit-warm-")
        self.socket = Path(self._folder.name, "socket")
        self.python = command(str(self.socket))

    def __enter__(self) -> Warm:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        environment.pop("PYTHONPATH", None)
        words = [sys.executable, "-P", __file__, str(self.socket)]
        self._process = subprocess.Popen(words, env=environment, stdin=subprocess.DEVNULL)
        while not self.socket.exists():
            if self._process.poll() is not None:
                raise RuntimeError("the interpreter that programs are forked from did not start; it said why")
            time.sleep(0.01)
        return self

    def __exit__(self, *exc: object) -> None:
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()


# ---- in the warm interpreter -----------------------------------------------------------------------------------------


def serve(path: str) -> tuple[list[str], dict[str, str]]:
    """Fork a program for each client; returns in the program only: its words after `python`, and its environment."""
    root = str(Path(__file__).parents[2])
    sys.path.insert(0, root)
    for name in (*PACKAGES, *OURS):
        with contextlib.suppress(ImportError):  # an extra that is not installed
            importlib.import_module(name)
    sys.modules["steerkit.cli.app"].command()
    sys.path.remove(root)
    gc.collect()
    gc.freeze()  # a look for garbage in a program would copy the memory of all packages
    gc.set_threshold(*SELDOM)
    for end in list(weakref.finalize._registry):  # type: ignore[attr-defined]
        end.atexit = False  # as would torch, which unregisters its operators one by one at the end
    server = socket.socket(socket.AF_UNIX)
    server.bind(path + ".new")
    server.listen(64)
    os.rename(path + ".new", path)  # it is there when it listens
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()
    clients: dict[int, tuple[socket.socket, int]] = {}
    """By the descriptor of its program's process: who waits for it, and the process."""
    while True:
        waiting = {client.fileno(): ended for ended, (client, _) in clients.items()}
        ready, _, _ = select.select([server.fileno(), *clients, *waiting], [], [], 5.0)
        if os.getppid() != parent and not clients:  # whoever started it was killed
            os._exit(0)
        for ended in {waiting.get(number, number) for number in ready} - {server.fileno()}:
            client, program = clients.pop(ended)
            if ended not in ready:  # the client is gone without a word: it was killed
                os.kill(program, signal.SIGKILL)
            _, status = os.waitpid(program, 0)
            with contextlib.suppress(OSError):
                client.sendall(f"{os.waitstatus_to_exitcode(status)}\n".encode())
            client.close()
            os.close(ended)
        if server.fileno() in ready:
            client, _ = server.accept()
            asked, streams = _received(client)
            program = os.fork()
            if program == 0:
                for one in (server, client, *(other for other, _ in clients.values())):
                    one.close()
                for ended in clients:
                    os.close(ended)
                return _become(asked, streams)
            for stream in streams:
                os.close(stream)
            clients[os.pidfd_open(program)] = client, program
            with contextlib.suppress(OSError):
                client.sendall(f"{program}\n".encode())


def _received(client: socket.socket) -> tuple[Any, array.array[int]]:
    """What a client asks for, and its three streams."""
    size, ancillary, _, _ = client.recvmsg(8, socket.CMSG_SPACE(12))
    streams = array.array("i")
    for _, _, data in ancillary:
        streams.frombytes(data)
    text, length = b"", int.from_bytes(size, "big")
    while len(text) < length:
        text += client.recv(length - len(text))
    return json.loads(text), streams


def _become(asked: Any, streams: array.array[int]) -> tuple[list[str], dict[str, str]]:
    """Take over streams, folder and signals of the client."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.setsid()
    os.chdir(asked["folder"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return asked["words"], asked["environment"]


def run(words: list[str], environment: dict[str, str]) -> None:
    """What `python WORDS` does, in this process."""
    os.environ.clear()
    os.environ.update(environment)
    time.tzset()
    sys.dont_write_bytecode = bool(environment.get("PYTHONDONTWRITEBYTECODE"))
    places = [os.path.abspath(part) for part in environment.get("PYTHONPATH", "").split(os.pathsep) if part]
    kind, *rest = words[words[0] == "-u" :]
    first = os.getcwd() if kind == "-m" else "" if kind == "-c" else os.path.dirname(os.path.realpath(kind))
    sys.path[:0] = [first, *places]
    importlib.invalidate_caches()
    for package in {name.partition(".")[0] for name in OURS}:
        specs = (finder.find_spec(package, None) for finder in sys.meta_path)
        found = next(filter(None, specs), None)
        if package in sys.modules and (found is None or found.origin != sys.modules[package].__file__):
            for name in [name for name in sys.modules if name.partition(".")[0] == package]:
                del sys.modules[name]
    if kind == "-m":
        if not hasattr(sys.modules.get(rest[0]), "__path__"):  # of a package it is `__main__` that runs
            sys.modules.pop(rest[0], None)
        sys.argv = rest
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif kind == "-c":
        sys.argv = ["-c", *rest[1:]]
        del sys.modules["__main__"].__file__
        exec(compile(rest[0], "<string>", "exec"), {"__name__": "__main__", "__builtins__": __builtins__})
    else:
        sys.argv = words
        runpy.run_path(kind, run_name="__main__")


def end_after(words: list[str], environment: dict[str, str]) -> None:
    """Run, and end as Python does, but for taking the imported packages apart, which takes longer than their import."""
    code: Any = 0
    try:
        run(words, environment)
    except SystemExit as stop:
        code = stop.code
        if code is None:
            code = 0
        elif not isinstance(code, int):
            print(code, file=sys.stderr)
            code = 1
    except KeyboardInterrupt:
        sys.excepthook(*sys.exc_info())
        code = -signal.SIGINT
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as the interpreter does
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code & 0xFF)


if __name__ == "__main__":
    end_after(*serve(sys.argv[1]))
