"""Programs that tests start: as a fork of this process, which has imported what they need already, or as any other."""

import atexit
import contextlib
import functools
import gc
import importlib
import logging
import os
import runpy
import select
import signal
import subprocess
import sys
import tempfile
import threading
import types
import warnings
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from multiprocessing import resource_tracker, util
from pathlib import Path
from typing import IO, Any

SHARED = (
    *("PIL", "benchmarks", "can", "cantools", "filelock", "joblib", "matplotlib", "mpl_toolkits", "numpy", "pandas"),
    *("pydantic", "rich", "scipy", "steerkit", "typer"),
)
"""Packages of which programs import parts late: this process imports those too, once, for the next programs."""
FIRST = (
    *("steerkit.cli.drive", "steerkit.cli.learn", "steerkit.cli.car", "steerkit.car.processes", "cantools"),
    *("matplotlib.style", "matplotlib.figure", "matplotlib.backends.backend_agg", "scipy.interpolate", "scipy.signal"),
)
COURSES = ("paper", "circle")
"""What most programs import, and the courses that most drive on: this process has both before the first."""
PNG = b"\x89PNG\r\n\x1a\n"
"""How such a file begins."""


def alive(pid: int) -> bool:
    """Does it still run? One whose end nobody has asked for yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")")[1].split()[0] != "Z"
    except OSError:
        return False


def python(
    *words: str, folder: Path, environment: Mapping[str, str] = os.environ, seconds: float = 300.0
) -> subprocess.CompletedProcess[str]:
    """What `python WORDS` does and prints, in a fork of this process: its imports are there, all else is its own.

    words: `-m MODULE ...`, `-c CODE ...` or `FILE ...`. What depends on a start from nothing (the time that it takes, a
    terminal, signals, a program that stays) starts `sys.executable` instead. Raises subprocess.TimeoutExpired.
    """
    _prepare()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err, tempfile.TemporaryFile("w+") as new:
        child = os.fork()
        if child == 0:
            _become(words, folder, dict(environment), (out.fileno(), err.fileno()), new)
        watch = os.pidfd_open(child)
        over = bool(select.select([watch], [], [], seconds)[0])
        os.close(watch)
        if not over:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
        ended = os.waitpid(child, 0)
        if not over:
            raise subprocess.TimeoutExpired(words, seconds)
        out.seek(0)
        err.seek(0)
        new.seek(0)
        for name in new.read().split():  # the next program finds them here
            with contextlib.suppress(ModuleNotFoundError):  # one that the program made itself
                importlib.import_module(name)
        return subprocess.CompletedProcess(words, os.waitstatus_to_exitcode(ended[1]), out.read(), err.read())


@functools.cache
def _prepare() -> None:
    """Import what most programs do, and make their courses: forks have both."""
    for name in FIRST:
        importlib.import_module(name)
    for name in COURSES:
        importlib.import_module("steerkit").course(name)


def _become(
    words: Sequence[str], folder: Path, environment: dict[str, str], streams: tuple[int, int], new: IO[str]
) -> None:
    """In the fork: the program, from its first line to its end; never returns. new: what it imported of SHARED."""
    code, before = 1, set(sys.modules)
    try:
        # whatever this process would do at its end (remove temporary folders, say) is not for the fork to do
        atexit._clear()
        weakref.finalize._registry.clear()  # type: ignore[attr-defined]
        util._finalizer_registry.clear()  # type: ignore[attr-defined]
        os.setsid()
        os.chdir(folder)
        with open(os.devnull, "rb") as nothing:
            os.dup2(nothing.fileno(), 0)
        for number, stream in enumerate(streams, start=1):
            os.dup2(stream, number)
        sys.stdin = os.fdopen(0, closefd=False, encoding="utf-8")
        sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False, encoding="utf-8") for number in (1, 2))
        os.environ.clear()
        os.environ.update(environment)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        warnings.resetwarnings()
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        warnings.showwarning = warnings._showwarning_orig  # type: ignore[attr-defined]
        sys.path[:0] = [str(folder), *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))]
        _alone()
        forking()
        if "matplotlib.figure" in sys.modules:  # to draw takes a third of a short command's time
            undrawn()
        code = _ended(words)
        threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as the interpreter does
        atexit._run_exitfuncs()
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
            new.write("\n".join(sorted(name for name in set(sys.modules) - before if name.partition(".")[0] in SHARED)))
            new.flush()
        os._exit(code & 0xFF)


class Forked(subprocess.Popen[str]):
    """`python -m MODULE ...` or `-c CODE ...` as a fork: imports take longer than most drives of the tests."""

    def _execute_child(self, args: Any, *how: Any) -> None:
        if args[0] != sys.executable or args[1] not in ("-m", "-c"):
            super()._execute_child(args, *how)  # type: ignore[misc]
            return
        _prepare()
        prepare, folder, environment = how[1], how[4], how[5]
        pipes = to_child, _, _, from_child, _, errors = how[9:15]  # as Popen orders them, -1: none
        streams = [(stream, number) for number, stream in enumerate((to_child, from_child, errors)) if stream >= 0]
        self.pid = _fork(
            args[1:], streams=streams, session=how[20], folder=folder, environment=environment, prepare=prepare
        )
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]


def _fork(
    words: Sequence[str],
    *,
    streams: Sequence[tuple[int, int]] = (),
    keep: Collection[int] = (),
    session: bool = False,
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
    prepare: Callable[[], object] | None = None,
) -> int:
    """Start `python WORDS` as a fork of this process; returns its id.

    streams: what its streams are, and their numbers. keep: descriptors that it has, beside those; no other is open.
    """
    sys.stdout.flush()  # else the child writes what waits in it to its own output
    sys.stderr.flush()
    if pid := os.fork():
        return pid
    code = 1
    try:
        if session:
            os.setsid()
        for stream, number in streams:
            os.dup2(stream, number)
        ends = [2, *sorted(keep), 1024]
        for one, other in pairwise(ends):
            os.closerange(one + 1, other)
        if folder is not None:
            os.chdir(folder)
            sys.path.insert(0, str(folder))
        if environment is not None:
            given = dict(environment)
            os.environ.clear()
            os.environ.update(given)
        if prepare:
            prepare()
        _alone()
        logging.root.handlers.clear()  # a test's
        tracker = resource_tracker._resource_tracker  # it was among those, if this process had used it
        tracker._fd = tracker._pid = None  # type: ignore[attr-defined]
        for name in ("concurrent.futures.process", "joblib.externals.loky.process_executor"):
            if name in sys.modules:  # processes that the parent has started are its own to end
                sys.modules[name]._threads_wakeups.clear()
        sys.stdin = os.fdopen(0, closefd=False, encoding="utf-8")
        sys.stdout, sys.stderr = (os.fdopen(n, "w", closefd=False, encoding="utf-8") for n in (1, 2))
        warnings.filterwarnings("ignore", category=RuntimeWarning, module="runpy")  # it was imported already
        code = _ended(words)
        threading._shutdown()  # type: ignore[attr-defined]
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code & 0xFF)


def _alone() -> None:
    """In a fork: what it starts are forks too, and its parent's garbage is none of its own.

    A loop collects garbage in its pauses. That went through all that the tests have imported, and ended in a callback
    of hypothesis, in which the KeyboardInterrupt of a signal that has come meanwhile is swallowed.
    """
    subprocess.Popen = Forked  # type: ignore[misc]
    gc.callbacks.clear()
    gc.freeze()


def forking(set_to: Callable[[Any, str, Any], None] = setattr) -> None:
    """What multiprocessing and joblib start are forks of this process, too.

    set_to: `monkeypatch.setattr`, for a test that starts them itself.
    """
    spawned = util.spawnv_passfds  # type: ignore[attr-defined]

    def spawn(path: Any, args: Sequence[str], fds: Collection[int]) -> int:
        words = args[1:][args[1:].index("-c") :]
        return _fork(words, keep=fds) if "spawn_main" in words[1] else spawned(path, args, fds)

    set_to(util, "spawnv_passfds", spawn)
    if "joblib" in sys.modules:
        loky = importlib.import_module("joblib.externals.loky.backend.fork_exec")
        executed = loky.fork_exec

        def execute(args: Sequence[str], fds: Collection[int], env: Mapping[str, str] | None = None) -> int:
            if not args[2].endswith("popen_loky_posix"):
                return executed(args, fds, env)
            return _fork(args[1:], keep=fds, environment={**os.environ, **(env or {})})

        set_to(loky, "fork_exec", execute)


def undrawn(set_to: Callable[[Any, str, Any], None] = setattr) -> None:
    """From now on pictures are written and not drawn: tests/contract/test_pictures.py draws each kind of them.

    A report's (SVG) and a film's, which are read again, are drawn, without layout. set_to: `monkeypatch.setattr`.
    """
    figure = importlib.import_module("matplotlib.figure").Figure
    drawn = figure.savefig

    def written(self: Any, file: Any, **how: Any) -> None:
        if how.get("format", "png") != "png":
            drawn(self, file, **how)
        elif hasattr(file, "write"):
            file.write(PNG)
        else:
            Path(file).write_bytes(PNG)

    set_to(figure, "savefig", written)
    set_to(figure, "get_layout_engine", lambda _: None)


def _ended(words: Sequence[str]) -> int:
    """Run the program; its exit code."""
    kind, *rest = words
    try:
        if kind == "-m":
            sys.argv = rest
            sys.modules.pop(rest[0] + ".__main__", None)
            runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
        elif kind == "-c":
            sys.argv = ["-c", *rest[1:]]
            main = sys.modules["__main__"] = types.ModuleType("__main__")
            exec(compile(rest[0], "<string>", "exec"), vars(main))
        else:
            sys.argv = list(words)
            runpy.run_path(kind, run_name="__main__")
    except SystemExit as stop:
        if stop.code is None or isinstance(stop.code, int):
            return stop.code or 0
        print(stop.code, file=sys.stderr)
        return 1
    return 0
