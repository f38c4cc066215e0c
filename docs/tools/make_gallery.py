"""Run the gallery's scripts, keep their pictures, write the page: python docs/tools/make_gallery.py [NAME ...]."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "examples" / "gallery"
PICTURES = ROOT / "docs" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
ORDER = (
    "what_is_wired",
    "tyre_saturation",
    "course_from_gps",
    "smooth_from_coarse",
    "hundred_gains",
    "recovery",
    "learns_in_a_minute",
    "policy_map",
    "six_under_delay",
)
HEAD = """\
# Gallery

Nine scripts of at most 45 lines, each with the picture that it draws, from `examples/gallery`; their blocks can be
pasted at Python's prompt.
"""


def for_a_prompt(code: str) -> str:
    """The same statements as they can be pasted at Python's prompt: there a blank line ends a statement.

    So blank lines inside of a class, a function or a loop go, except in texts, and one comes after each of them.
    """
    tree = ast.parse(code)
    inside: set[int] = set()
    last: set[int] = set()
    for statement in tree.body:
        if hasattr(statement, "body"):
            inside |= {*range(statement.lineno, statement.end_lineno or statement.lineno)}
            last.add(statement.end_lineno or statement.lineno)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            inside -= {*range(node.lineno, node.end_lineno or node.lineno)}
    lines = code.splitlines()
    made: list[str] = []
    for n, line in enumerate(lines, start=1):
        if line.strip() or n not in inside:
            made.append(line)
        if n in last and n < len(lines) and lines[n].strip():
            made.append("")
    return "\n".join(made)


def page() -> str:
    """The page of the scripts as they are now."""
    parts = [HEAD]
    for name in ORDER:
        text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
        tree = ast.parse(text)
        said = ast.get_docstring(tree) or ""
        title, _, rest = said.partition("\n")
        title, _, more = title.rstrip(".").partition(": ")
        lead = f"{more[:1].upper()}{more[1:]}. " if more else ""
        code = for_a_prompt("\n".join(text.splitlines()[tree.body[0].end_lineno :]).strip())
        parts.append(
            f"## {title}\n\n{lead}{rest.strip()}\n\n![{title}](gallery/{name}.png)\n\n```python\n{code}\n```\n"
        )
    return "\n".join(parts)


def main() -> None:
    """Draw the pictures (of the scripts named, or of all) and write the page."""
    PICTURES.mkdir(exist_ok=True)
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    for name in sys.argv[1:] or ORDER:
        print(f"== {name}", flush=True)
        environment = {**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": path}
        subprocess.run([sys.executable, str(SCRIPTS / f"{name}.py")], cwd=PICTURES, env=environment, check=True)
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
