"""Slips put into the code one at a time, and whether a test notices: `python -m tests.support.mutate`.

A slip is a small mistake that somebody could make: a wrong sign, a check forgotten. They are listed in
tests/support/slips/*.toml:

    [[slip]]
    file = "steerkit/diagram/units.py"     # where, from the root of the checkout
    before = "1609.344"            # what stands there, exactly once
    after = "1852.0"               # what stands there with the slip
    why = "a nautical mile"        # what is wrong with it, in plain words
    tests = ["tests/unit/..."]     # who should notice; by default the test that mirrors the file

Each slip is made in a copy of the tree with caches of its own, never in the tree itself, and its tests run there:

    killed     a test failed, as it should
    survived   all its tests passed: a test is missing
    stale      `before` is not found exactly once, the slip is no Python, or a test that it names is not there
    timed out  its tests took four times as long as without it, and half a minute
    untested   one of its tests fails without the slip too, or cannot be run
    not run    the time given by --minutes was over

Before its first use, each test runs without any slip and has to pass. The exit code is 1 unless all slips that ran were
killed.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.support.places import ROOT, SUPPORT

SLIPS = SUPPORT / "slips"
FIELDS = {"file", "before", "after", "why", "tests"}
GRACE = 30.0
"""Seconds that a slip's tests may take beyond four times their usual time."""


@dataclass(frozen=True)
class Slip:
    """One mistake: `before` in `file` becomes `after`; `tests` (paths, or pytest's node ids) should notice. `listed`:
    the file that lists it."""

    file: str
    before: str
    after: str
    why: str
    tests: tuple[str, ...]
    listed: str

    def __str__(self) -> str:
        return f"{self.file}: {self.why}"

    def contains(self, text: str) -> bool:
        """Does the text occur in any of its fields?"""
        return any(text in part for part in (self.file, self.before, self.after, self.why, *self.tests))


@dataclass(frozen=True)
class Verdict:
    """What became of a slip; `detail` is the test that failed, or what is wrong with the slip."""

    slip: Slip
    outcome: str
    detail: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """How pytest ended: its exit code (None: it took too long), the first failure, seconds, what it printed."""

    code: int | None
    failure: str
    seconds: float
    printed: str


def mirror(file: str) -> str:
    """The test that a file's name leads to: steerkit/a/b.py has tests/unit/a/test_b.py, benchmarks/b.py has
    tests/unit/benchmarks/test_b.py, and a package's own __init__.py has the test named like the package."""
    path = Path(file)
    parts = path.parts[1:] if path.parts[0] == "steerkit" else path.parts
    folder, name = parts[:-1], path.stem
    if name == "__init__":
        name = folder[-1] if folder else "steerkit"
    return str(Path("tests/unit", *folder, f"test_{name.strip('_')}.py"))


def read(folder: Path = SLIPS) -> list[Slip]:
    """All slips of a folder's TOML files; ValueError names the file and the slip with a field missing or unknown."""
    slips = []
    for file in sorted(folder.glob("*.toml")):
        for entry in tomllib.loads(file.read_text(encoding="utf-8")).get("slip", []):
            where = f"{file.name}, slip {entry.get('why', entry)!r}"
            if unknown := entry.keys() - FIELDS:
                raise ValueError(f"{where}: unknown fields {sorted(unknown)}; valid: {sorted(FIELDS)}")
            if missing := FIELDS - {"tests"} - entry.keys():
                raise ValueError(f"{where}: fields {sorted(missing)} are missing")
            tests = tuple(entry.get("tests") or [mirror(entry["file"])])
            slips.append(Slip(entry["file"], entry["before"], entry["after"], entry["why"], tests, file.name))
    return slips


def applied(slip: Slip, root: Path) -> str:
    """The file's text with the slip; ValueError if the slip is stale."""
    file = root / slip.file
    if not file.is_file():
        raise ValueError("the file is not there")
    text = file.read_text(encoding="utf-8")
    if (number := text.count(slip.before)) != 1:
        raise ValueError(f"its `before` stands there {number} times, expected once: {slip.before!r}")
    if absent := [test for test in slip.tests if not _is_there(root, test)]:
        raise ValueError(f"no test {', '.join(absent)}: name its tests")
    wrong = text.replace(slip.before, slip.after)
    if wrong == text:
        raise ValueError("before and after are the same")
    if file.suffix == ".py":
        try:
            compile(wrong, slip.file, "exec")
        except SyntaxError as error:
            raise ValueError(f"with it the file is no Python: {error}") from error
    return wrong


def _is_there(root: Path, test: str) -> bool:
    """Is there such a path; and, of a node id, a test of that name in the file?"""
    file, _, node = test.partition("::")
    name = node.split("::")[-1].split("[")[0]
    return (root / file).exists() and (not name or f"def {name}(" in (root / file).read_text(encoding="utf-8"))


def stale(slips: Iterable[Slip], root: Path = ROOT) -> list[Verdict]:
    """The slips that cannot be made any more, and why."""
    verdicts = []
    for slip in slips:
        try:
            applied(slip, root)
        except ValueError as error:
            verdicts.append(Verdict(slip, "stale", str(error)))
    return verdicts


class Copies:
    """A clean copy of the tree, and copies of it, with a slip or without; all caches stay inside the folder."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder, self.clean = folder, folder / "clean"
        self._numbers = itertools.count()
        self._usual: dict[str, float] = {}
        self._locks: dict[str, threading.Lock] = {}
        for name in _tracked(root):
            if (root / name).is_file():
                (self.clean / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, self.clean / name)
        # Bytecode checked by content: by time and size, a slip of the same length within a second is not noticed.
        command = [sys.executable, "-m", "compileall", "-qq", "--invalidation-mode", "checked-hash", str(self.clean)]
        subprocess.run(command, check=False, stdout=subprocess.DEVNULL)

    def usual_seconds(self, test: str) -> float:
        """How long a test takes without a slip, in a process of its own. RuntimeError if it fails."""
        with self._locks.setdefault(test, threading.Lock()):
            if test not in self._usual:
                outcome = self.pytest([test], 1800.0)
                if outcome.code != 0:
                    raise RuntimeError(f"{test} fails without a slip: {outcome.failure or outcome.printed[-2000:]}")
                self._usual[test] = outcome.seconds
            return self._usual[test]

    def pytest(self, tests: Sequence[str], seconds: float, slip: Slip | None = None) -> Outcome:
        """Run tests in a copy of their own, with processes that outlive a test or hang ended."""
        number = next(self._numbers)
        tree, temporary = self.folder / f"{number}", self.folder / f"{number}t"
        shutil.copytree(self.clean, tree)
        # Compiled code is kept by its source, so all may share it, but for the code that looks after that.
        cache = self.folder / "cache"
        if slip is not None:
            wrong = applied(slip, tree)
            (tree / slip.file).write_text(wrong, encoding="utf-8")
            if "XDG_CACHE_HOME" in wrong:
                cache = tree / "cache"
        words = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", "--tb=no", "-rfE"]
        command = [sys.executable, "-m", "pytest", *words, "--basetemp", str(temporary), *tests]
        environment = os.environ | {
            "PYTHONPATH": str(tree),
            "PYTHONDONTWRITEBYTECODE": "1",
            "XDG_CACHE_HOME": str(cache),
            "OMP_NUM_THREADS": "1",
            "HYPOTHESIS_PROFILE": "slips",  # of tests/conftest.py: a failure need not be made small
            "COLUMNS": "200",
        }
        start = time.monotonic()
        with (self.folder / f"{number}.out").open("w+b") as out:
            process = subprocess.Popen(
                command, cwd=tree, env=environment, stdout=out, stderr=subprocess.STDOUT, start_new_session=True
            )
            try:
                code: int | None = process.wait(timeout=seconds)
            except subprocess.TimeoutExpired:
                code = None
            finally:
                _end(process)
            out.seek(0)
            printed = out.read().decode(errors="replace")
        passed = time.monotonic() - start
        failure = re.search(r"^(?:FAILED|ERROR) (\S+)", printed, re.MULTILINE)
        for folder in (tree, temporary):
            shutil.rmtree(folder, ignore_errors=True)
        return Outcome(code, failure[1] if failure else "", passed, printed)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _tracked(root: Path) -> list[str]:
    """The files of a checkout, new ones included; of a folder that is none, all but caches."""
    if (root / ".git").exists():
        return _git(root, "ls-files", "-z", "--cached", "--others", "--exclude-standard").split("\0")[:-1]
    files = (file.relative_to(root) for file in root.rglob("*"))
    return [str(file) for file in files if not any(p.startswith(".") or p == "__pycache__" for p in file.parts)]


def _git(root: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True).stdout


def changed(root: Path, base: str) -> set[str]:
    """Files that differ from a commit, new ones included. Without a base: from where the branch left origin/main, or
    else from the commit before; where neither is known (a shallow clone), all files."""
    for known in [base] if base else ["origin/main", "HEAD~1"]:
        try:
            head = _git(root, "rev-parse", "HEAD").strip()
            fork = _git(root, "merge-base", known, "HEAD").strip()
        except subprocess.CalledProcessError as error:
            if base:
                raise SystemExit(f"--changed {base}: {error.stderr.strip()}") from error
            continue
        if base or fork != head or known == "HEAD~1":
            names = _git(root, "diff", "--name-only", "-z", fork) + _git(
                root, "ls-files", "-z", "--others", "--exclude-standard"
            )
            return set(names.split("\0")[:-1])
    return set(_tracked(root))


def selected(slips: Iterable[Slip], only: str, files: set[str] | None) -> list[Slip]:
    """Slips that contain a text; with `files`, those whose own file, test or list is among these."""

    def touched(slip: Slip) -> bool:
        own = {slip.file, f"tests/support/slips/{slip.listed}", *(test.split("::")[0] for test in slip.tests)}
        return files is None or not own.isdisjoint(files)

    return [slip for slip in slips if slip.contains(only) and touched(slip)]


def run(
    slips: Sequence[Slip], root: Path, *, jobs: int = 1, minutes: float = float("inf"), all_tests: bool = False
) -> list[Verdict]:
    """Make every slip and see who notices."""
    end = time.monotonic() + 60.0 * minutes
    verdicts = {verdict.slip: verdict for verdict in stale(slips, root)}
    fresh = [slip for slip in slips if slip not in verdicts]
    for verdict in verdicts.values():
        _say(verdict)
    with tempfile.TemporaryDirectory(prefix="slips-") as name, ThreadPoolExecutor(jobs) as pool:
        copies = Copies(root, Path(name))

        def try_out(slip: Slip, tests: Sequence[str]) -> Verdict:
            if time.monotonic() > end:
                return Verdict(slip, "not run")
            try:
                limit = GRACE + 4.0 * sum(map(copies.usual_seconds, tests))
            except RuntimeError as error:
                return _say(Verdict(slip, "untested", str(error)))
            outcome = copies.pytest(tests, limit, slip)
            match outcome.code:
                case None:
                    word, detail = "timed out", f"after {limit:.0f} s"
                case 0:
                    word, detail = "survived", f"{', '.join(tests)} passed"
                case code if code in (1, 2) or code < 0:  # a test failed; could not be loaded; the process crashed
                    word, detail = "killed", outcome.failure or f"exit code {code}"
                case code:
                    word, detail = "untested", f"pytest ended with {code}:\n{outcome.printed[-2000:]}"
            return _say(Verdict(slip, word, detail, round(outcome.seconds, 1)))

        try:
            for verdict in pool.map(lambda slip: try_out(slip, slip.tests), fresh):
                verdicts[verdict.slip] = verdict
            if all_tests:
                survivors = [slip for slip in fresh if verdicts[slip].outcome == "survived"]
                for verdict in pool.map(lambda slip: try_out(slip, ["tests"]), survivors):
                    verdicts[verdict.slip] = verdict
        finally:
            pool.shutdown(cancel_futures=True)
    return [verdicts[slip] for slip in slips]


def _say(verdict: Verdict) -> Verdict:
    print(f"{verdict.outcome:10s}{verdict.slip}", file=sys.stderr)
    if verdict.detail:
        print(f"{'':10s}  {verdict.detail} ({verdict.seconds:.1f} s)", file=sys.stderr, flush=True)
    return verdict


def main(words: Sequence[str] | None = None) -> int:
    """The command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.mutate", description=(__doc__ or "").splitlines()[0])
    option = parser.add_argument
    option("--only", default="", metavar="TEXT", help="only slips with this text in any of their fields")
    option(
        "--changed",
        nargs="?",
        const="",
        metavar="BASE",
        help="only slips whose file, test or list differs from a commit",
    )
    option("--jobs", type=int, default=1, help="how many slips at once (default: 1)")
    option("--minutes", type=float, default=float("inf"), help="start no slip after this time; the order is then mixed")
    option("--all-tests", action="store_true", help="run the whole suite for slips that survive their own tests")
    option("--list", action="store_true", help="list slips, stale ones marked, and run nothing")
    option("--json", action="store_true", help="print the result as JSON")
    option("--root", type=Path, default=ROOT, help="the checkout (default: this one)")
    option("--slips", type=Path, help="folder of TOML files (default: tests/support/slips of the checkout)")
    args = parser.parse_args(words)
    slips = selected(
        read(args.slips or args.root / SLIPS.relative_to(ROOT)),
        args.only,
        None if args.changed is None else changed(args.root, args.changed),
    )
    if args.list:
        old = {verdict.slip: verdict for verdict in stale(slips, args.root)}
        verdicts = [old.get(slip, Verdict(slip, "fresh")) for slip in slips]
    else:
        if args.minutes < float("inf"):  # another order for each commit, so that over time all have their turn
            seed = _git(args.root, "rev-parse", "HEAD") if (args.root / ".git").exists() else ""
            slips = random.Random(seed).sample(slips, len(slips))
        verdicts = run(slips, args.root, jobs=args.jobs, minutes=args.minutes, all_tests=args.all_tests)
    numbers: Mapping[str, int] = Counter(verdict.outcome for verdict in verdicts)
    if args.json:
        print(json.dumps({"numbers": numbers, "slips": [_flat(verdict) for verdict in verdicts]}, indent=1))
    else:
        for verdict in verdicts:
            if args.list or verdict.outcome != "killed":
                print(f"{verdict.outcome:10s}{verdict.slip}" + (f" ({verdict.detail})" if verdict.detail else ""))
        print(f"{len(verdicts)} slips" + "".join(f", {number} {word}" for word, number in sorted(numbers.items())))
    return 0 if not numbers.keys() - {"killed", "fresh", "not run"} else 1


def _flat(verdict: Verdict) -> dict[str, object]:
    return asdict(verdict.slip) | {k: v for k, v in asdict(verdict).items() if k != "slip"}


if __name__ == "__main__":
    sys.exit(main())
