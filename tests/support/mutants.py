"""Mutation testing: `python -m tests.support.mutants` draws mutants of steerkit by seed and runs the tests on each.

A mutant is one small change of the code: another operator or comparison, a negated condition, another constant, a
dropped `not` or minus, None in place of a returned value. The lines are those of steerkit/ that differ from a commit
(--changed [BASE], the default), or all (--all), below some folders or files (--under). For each mutant pytest runs, in
a copy of the tree, the test that mirrors the module, the tests that import it, those of the modules that import it,
and the contracts; it stops at the first failure. A failure counts if the same test passes on the unchanged code.

    caught     a test failed, crashed or hung
    survived   all tests passed
    unfinished none had failed after --seconds, and some had not run
    not run    --minutes were over

Survivors are printed with place and diff.
"""

import argparse
import ast
import builtins
import contextlib
import difflib
import itertools
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Queue

from tests.support import house
from tests.support.places import ROOT

HUNG = 120
"""Seconds after which a single test counts as hung."""
SWAPS = "+ -, - +, * /, / *, // /, % *, ** *, & |, | &, < <=, < >=, <= <, <= >, > >=, > <=, >= >, >= <, == !=, != =="
WORDS = {"is": ["is not"], "is not": ["is"], "in": ["not in"], "not in": ["in"], "and": ["or"], "or": ["and"]}
OTHER = WORDS | {old: [new for one, new in map(str.split, SWAPS.split(",")) if one == old] for old in SWAPS.split()}
SYMBOL = re.compile(r"//|\*\*|<=|>=|==|!=|is\s+not|not\s+in|is|in|and|or|[-+*/%&|<>]")
UNSEEN = ("annotation", "returns", "decorator_list", "bases")
"""Fields of a node that hold types."""


@dataclass(frozen=True)
class Mutant:
    """`before`, at the byte `start` of `file`, becomes `after`; what became of it, and the test that failed."""

    file: str
    line: int
    start: int
    before: str
    after: str
    outcome: str = "not run"
    test: str = ""
    seconds: float = 0.0

    def applied(self, source: bytes) -> bytes:
        """The text of the file with the mutant."""
        return source[: self.start] + self.after.encode() + source[self.start + len(self.before.encode()) :]

    def diff(self) -> str:
        """The lines that differ."""
        source = (ROOT / self.file).read_bytes()
        old, new = source.decode().splitlines(), self.applied(source).decode().splitlines()
        return "\n".join(list(difflib.unified_diff(old, new, n=0, lineterm=""))[3:])


def mutants(file: str, source: bytes) -> Iterator[Mutant]:
    """Every mutant of a module, but for those in texts, type hints, errors and `__repr__`, which no test should see."""
    starts = [0, *itertools.accumulate(map(len, source.splitlines(keepends=True)))]

    def span(node: ast.expr) -> tuple[int, int]:
        end = starts[(node.end_lineno or 1) - 1] + (node.end_col_offset or 0)
        return starts[node.lineno - 1] + node.col_offset, end

    def made(line: int, start: int, end: int, after: str) -> Mutant:
        return Mutant(file, line, start, source[start:end].decode(), after)

    def between(*operands: ast.expr) -> Iterator[Mutant]:
        """Another operator between operands."""
        for left, right in itertools.pairwise(operands):
            first = span(left)[1]
            text = re.sub(rb"#.*", lambda comment: b" " * len(comment[0]), source[first : span(right)[0]]).decode()
            if found := SYMBOL.search(text):
                start = first + len(text[: found.start()].encode())
                for other in OTHER[" ".join(found[0].split())]:
                    yield made(left.end_lineno or left.lineno, start, start + len(found[0]), other)

    def of(node: ast.AST, name: bool) -> Iterator[Mutant]:
        """Mutants of a node without its children. name: a text here is a default or is compared."""

        def instead(old: ast.expr, new: str, of: ast.expr | None = None) -> Mutant:
            start, end = span(of or old)
            return made(old.lineno, *span(old), new.format(source[start:end].decode()))

        match node:
            case ast.Constant(value=bool() as value):
                yield instead(node, str(not value))
            case ast.Constant(value=(int() | float()) as value):
                yield instead(node, repr(value + 1 if isinstance(value, int) or not value else 1.5 * value))
            case ast.Constant(value=str() as value) if name and value.isidentifier():
                yield instead(node, repr(f"not_{value}"))
            case ast.BinOp(left, operator, right):
                texts = isinstance(left, ast.JoinedStr) or isinstance(getattr(left, "value", None), str)
                words = re.split(r"\W+", ast.unparse(node))
                types = any(word == "None" or word in dir(builtins) or word[:1].isupper() for word in words)
                joined = isinstance(operator, ast.BitOr) and types
                if not texts and not joined and not isinstance(operator, ast.MatMult):
                    yield from between(left, right)
            case ast.AugAssign(target, _, value):
                yield from between(target, value)
            case ast.Compare(left, _, others):
                yield from between(left, *others)
            case ast.BoolOp(_, values):
                yield from between(*values)
            case ast.UnaryOp(ast.Not() | ast.USub(), operand):
                yield instead(node, "({})", operand)
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
                yield instead(test, "(not ({}))", test)
            case ast.Return(value=ast.expr() as value) if ast.unparse(value) != "None":
                yield instead(value, "None")

    def walk(node: ast.AST, name: bool = False) -> Iterator[Mutant]:
        match node:
            case ast.Raise() | ast.Assert() | ast.JoinedStr() | ast.Assign(targets=[ast.Name(id="__all__")]):
                return
            case ast.If(test=test) if re.search("TYPE_CHECKING|__name__", ast.unparse(test)):
                return
            case ast.FunctionDef(name="__repr__" | "__str__"):
                return
            case ast.Call(func=ast.Name(id="require"), args=[condition, *_]):
                yield from walk(condition)
                return
        yield from of(node, name)
        for field, value in ast.iter_fields(node):
            names = isinstance(node, (ast.Compare, ast.arguments)) or (
                isinstance(node, ast.AnnAssign) and field == "value"
            )
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and field not in UNSEEN:
                    yield from walk(child, names)

    yield from walk(ast.parse(source))


def git(*words: str) -> str:
    """The output of a git command."""
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, encoding="utf-8").stdout


def changed_lines(base: str) -> dict[str, set[int]]:
    """Lines of steerkit/ that differ from the commit where HEAD left `base`; from the commit before, if it did not."""
    lines: dict[str, set[int]] = {}
    for known in (base, "HEAD~1"):
        with contextlib.suppress(subprocess.CalledProcessError):
            for line in git("diff", "-U0", git("merge-base", known, "HEAD").strip(), "--", "steerkit").splitlines():
                if line.startswith("+++ b/"):
                    file = line[6:]
                elif found := re.match(r"@@ \S+ \+(\d+)(?:,(\d+))?", line):
                    first, number = int(found[1]), int(found[2] or 1)
                    lines.setdefault(file, set()).update(range(first, first + number))
        if lines:
            break
    return lines


def drawn(lines: dict[str, set[int]] | None, under: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Mutants at random, one of a place at most: of those lines, or of all; of these folders or files, or of all."""
    found: dict[tuple[str, int], list[Mutant]] = {}
    for path in sorted((ROOT / "steerkit").rglob("*.py")):
        file = path.relative_to(ROOT)
        if (lines is None or str(file) in lines) and (not under or any(file.is_relative_to(one) for one in under)):
            for mutant in mutants(str(file), path.read_bytes()):
                if lines is None or mutant.line in lines[mutant.file]:
                    found.setdefault((mutant.file, mutant.start), []).append(mutant)
    dice = random.Random(seed)
    return [dice.choice(found[place]) for place in dice.sample(sorted(found), min(count, len(found)))]


def covering(file: str) -> list[str]:
    """Tests for a module, the nearest first: its mirror, what every block keeps, those that import it (who imports
    least first), the mirrors of modules that import it, parts of a mirror (test_reading_formats.py of
    test_reading.py), the other contracts."""
    files = house.modules(ROOT, "steerkit") | house.modules(ROOT, "tests")
    places = {name: str(path.relative_to(ROOT)) for name, path in files.items()}
    stub = (node for node in house.tree(ROOT / "steerkit" / "__init__.pyi").body if isinstance(node, ast.ImportFrom))
    edges = house.graph(
        files, {f"steerkit.{one.name}": f"steerkit.{line.module}" for line in stub for one in line.names}
    )
    importers = sorted(
        (name for name, targets in edges.items() if any(places[target] == file for target in targets)),
        key=lambda name: (len(edges[name]), name),
    )
    direct = [places[name] for name in importers if ".test_" in name]
    next_ones = [house.mirror(places[name]) for name in importers if name.startswith("steerkit")]
    mirrors = [Path(house.mirror(file)), *map(Path, next_ones)]
    parts = [str(part.relative_to(ROOT)) for m in mirrors for part in sorted((ROOT / m).parent.glob(f"{m.stem}_*.py"))]
    contracts = [f"tests/contract/test_{one}.py" for one in ("blocks", "same_everywhere", "wrong_inputs", "documents")]
    tests = dict.fromkeys([house.mirror(file), contracts[0], *direct, *next_ones, *parts, *contracts])
    return [test for test in tests if (ROOT / test).is_file()]


class Copies:
    """Copies of the tree, one for each job; pytest runs in them with one file changed."""

    def __init__(self, folder: Path, jobs: int, seconds: float) -> None:
        self.seconds = seconds
        self.free: Queue[Path] = Queue()
        self._clean: dict[str, bool] = {}
        for tree in (folder / str(job) for job in range(jobs)):
            for name in git("ls-files", "-z", "--cached", "--others", "--exclude-standard").split("\0")[:-1]:
                if (ROOT / name).is_file():
                    (tree / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(ROOT / name, tree / name)
            # Bytecode checked by content: by time and size, a change of the same length within a second is not noticed.
            compiling = ["-m", "compileall", "-qq", "--invalidation-mode", "checked-hash", str(tree)]
            subprocess.run([sys.executable, *compiling], check=False, stdout=subprocess.DEVNULL)
            self.free.put(tree)

    def judged(self, mutant: Mutant, tests: Sequence[str]) -> Mutant:
        """The mutant with its outcome."""
        tree, start, ignored = self.free.get(), time.monotonic(), list[str]()
        file = tree / mutant.file
        original, outcome = file.read_bytes(), ""
        while not outcome:
            file.write_bytes(mutant.applied(original))
            words = [*tests, *(f"--deselect={one}" for one in ignored)]
            code, test = self.pytest(tree, words, self.seconds - (time.monotonic() - start))
            file.write_bytes(original)
            if code in (0, None):
                outcome, test = "survived" if code == 0 else "unfinished", ""
            elif test in ("", *ignored) or self.passes(tree, test):
                outcome = "caught"
            ignored.append(test)
        self.free.put(tree)
        return replace(mutant, outcome=outcome, test=test, seconds=round(time.monotonic() - start, 1))

    def passes(self, tree: Path, test: str) -> bool:
        """Does a test pass on the unchanged code?"""
        if test not in self._clean:
            self._clean[test] = self.pytest(tree, [test], 10.0 * HUNG)[0] == 0
        return self._clean[test]

    def pytest(self, tree: Path, words: Sequence[str], seconds: float) -> tuple[int | None, str]:
        """Exit code (None: the time was over), and the test that failed or was running last."""
        temporary = tree.with_name(f"{tree.name}-temporary")
        options = "-m pytest -xv --tb=no -p tests.support.mutants --hypothesis-seed=0"
        command = [sys.executable, *options.split()]
        environment = os.environ | {
            "PYTHONPATH": str(tree),
            "PYTHONDONTWRITEBYTECODE": "1",
            "XDG_CACHE_HOME": str(tree.with_name("cache")),  # compiled code is kept by its source
            "OMP_NUM_THREADS": "1",
            "HYPOTHESIS_PROFILE": "mutants",  # of tests/conftest.py: a failure need not be made small
        }
        with tree.with_name(f"{tree.name}-out").open("w+b") as out:
            command += ["--basetemp", str(temporary), *words]
            process = subprocess.Popen(command, cwd=tree, env=environment, stdout=out, stderr=out, process_group=0)
            try:
                code: int | None = process.wait(max(seconds, 1.0))
            except subprocess.TimeoutExpired:
                code = None
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            out.seek(0)
            printed = out.read().decode(errors="replace")
        shutil.rmtree(temporary, ignore_errors=True)
        failed = re.findall(r"^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", printed, re.M)
        started = re.findall(r"^(tests/\S+\.py::.*?)(?: (?:PASSED|FAILED|ERROR|SKIPPED|XFAIL).*)?$", printed, re.M)
        return code, (failed or started[-1:] or [""])[0]


def pytest_runtest_logstart() -> None:
    """As a plugin of pytest: a test that hangs ends the process."""
    signal.alarm(HUNG)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    option = parser.add_argument
    option("--changed", nargs="?", const="origin/main", default="origin/main", metavar="BASE", help="lines that differ")
    option("--all", action="store_true", help="all lines")
    option("--under", nargs="+", default=[], metavar="PATH", help="only these folders or files, such as steerkit/car")
    option("--count", type=int, default=200, help="how many at most (default: 200)")
    option("--seed", type=int, default=0, help="for the draw (default: 0)")
    option("--jobs", type=int, default=2, help="how many at once (default: 2)")
    option("--minutes", type=float, default=float("inf"), help="start none after this time")
    option("--seconds", type=float, default=300.0, help="for the tests of one mutant (default: 300)")
    args = parser.parse_args()
    end = time.monotonic() + 60.0 * args.minutes
    chosen = drawn(None if args.all else changed_lines(args.changed), args.under, args.count, args.seed)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(args.jobs) as pool:
        copies = Copies(Path(folder), args.jobs, args.seconds)
        tests = {file: covering(file) for file in {mutant.file for mutant in chosen}}

        def judged(mutant: Mutant) -> Mutant:
            if time.monotonic() < end:
                mutant = copies.judged(mutant, tests[mutant.file])
                print(f"{mutant.outcome:11s}{mutant.file}:{mutant.line} {mutant.test}", file=sys.stderr, flush=True)
            return mutant

        chosen = list(pool.map(judged, chosen))
    numbers = Counter(mutant.outcome for mutant in chosen)
    ran = numbers["caught"] + numbers["survived"]
    share = 100.0 * numbers["caught"] / ran if ran else 100.0
    for mutant in chosen:
        if mutant.outcome in ("survived", "unfinished"):
            print(f"{mutant.outcome} {mutant.file}:{mutant.line}\n{mutant.diff()}")
    print(f"{len(chosen)} mutants, {numbers['caught']} of {ran} caught ({share:.0f} %), {dict(numbers)}")


if __name__ == "__main__":
    main()
