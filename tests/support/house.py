"""The modules of a package, what each imports, inside functions too, and cycles of imports."""

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path


def modules(root: Path, package: str) -> dict[str, Path]:
    """Dotted name and file of every module of a package."""
    files = sorted((root / package).rglob("*.py"))
    return {".".join(f.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


@cache
def parsed(text: str) -> ast.Module:
    """The syntax tree of a module's text, for looking only: a dozen tests look at all modules."""
    return ast.parse(text)


def tree(file: Path) -> ast.Module:
    """The syntax tree of a file, for looking only."""
    return parsed(file.read_text(encoding="utf-8"))


def imported(file: Path) -> tuple[tuple[str, bool], ...]:
    """(what is imported, is it at the top of the file); what only type checkers see is left out."""
    return _imported(file, file.read_text(encoding="utf-8"))


@cache
def _imported(file: Path, text: str) -> tuple[tuple[str, bool], ...]:

    def walk(node: ast.AST, top: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.Import):
                yield from ((alias.name, top) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{file}: relative import"
                yield from ((f"{child.module}.{alias.name}", top) for alias in child.names)
            inside = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
            yield from walk(child, top and not inside)

    return tuple(walk(parsed(text), True))


def graph(files: Mapping[str, Path], public: Mapping[str, str] | None = None) -> dict[str, set[str]]:
    """Which module imports which of the same packages, at its top or inside a function. public: names that a package
    passes on, and the module that each stands in."""
    edges: dict[str, set[str]] = {name: set() for name in files}
    for name, file in files.items():
        for target, _ in imported(file):
            target = (public or {}).get(target, target)
            module = target if target in files else target.rpartition(".")[0]
            if module in files and module != name:
                edges[name].add(module)
    return edges


def cycles(edges: Mapping[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other in a circle (strongly connected, two or more)."""

    def reach(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = [start]
        while waiting:
            for following in edges[waiting.pop()] - seen:
                seen.add(following)
                waiting.append(following)
        return seen

    far = {name: reach(name) for name in edges}
    groups = {frozenset(b for b in far[a] if a in far[b]) for a in edges if a in far[a]}
    return sorted(sorted(group) for group in groups)


def mirror(file: str) -> str:
    """The test that a file's name leads to: steerkit/a/b.py has tests/unit/a/test_b.py, benchmarks/b.py has
    tests/unit/benchmarks/test_b.py, and a package's own __init__.py has the test named like the package."""
    path = Path(file)
    parts = path.parts[1:] if path.parts[0] == "steerkit" else path.parts
    folder, name = parts[:-1], path.stem
    if name == "__init__":
        name = folder[-1] if folder else "steerkit"
    return str(Path("tests/unit", *folder, f"test_{name.strip('_')}.py"))
