"""Every equation of the site is typeset: those of docstrings by docs/tools/formulas.py, those of pages by hand."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.browser import BROWSER, FRAME, FRAME_JS, shown
from tests.support.house import tree
from tests.support.places import ROOT

TELLS = """<script>addEventListener('load', () => parent.postMessage(JSON.stringify({
formulas: document.querySelectorAll('.katex').length, width: document.documentElement.scrollWidth,
errors: [...document.querySelectorAll('.katex-error, .katex-html [style*=color]')].map(one => one.textContent)}), '*'))
</script>"""
"""KaTeX shows what it cannot read as an error, and a command it does not know in colour."""
LITERAL = {
    "steerkit.analysis",
    "steerkit.cli.identify.identify",
    "steerkit.export.c.export_c",
    "steerkit.identification",
    "steerkit.learning.rundir",
    "steerkit.car.learner",
    "steerkit.car.state_machine.step",
}
"""Docstrings with a program, a list of files or a diagram, announced by `::`."""


@pytest.fixture(scope="module")
def tools() -> Iterator[tuple[ModuleType, ModuleType]]:
    """docs/tools/formulas.py and docstrings.py, which the site's build loads."""
    pytest.importorskip("griffe")
    sys.path.insert(0, str(ROOT / "docs" / "tools"))
    try:
        import docstrings
        import formulas

        yield formulas, docstrings
    finally:
        sys.path.remove(str(ROOT / "docs" / "tools"))


def written() -> Iterator[tuple[str, str]]:
    """Dotted name and docstring of all modules, classes and functions of the package."""
    for file in sorted((ROOT / "steerkit").rglob("*.py")):
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for node in ast.walk(tree(file)):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and (text := ast.get_docstring(node)):
                yield f"{module}.{node.name}" if not isinstance(node, ast.Module) else module, text


CASES = {
    "delta = (L + K v^2) kappa": r"\delta = ( L + K\,v^{2} )\,\kappa",
    # all factors of a product stand over the stroke, and brackets that only hold the fraction together go
    "r' = (l_f c_f alpha_f - l_r c_r)/(m v)": r"r' = \frac{l_{f}\,c_{f}\,\alpha_{f} - l_{r}\,c_{r}}{m\,v}",
    "m*v*r_path / (c_f*L)": r"\frac{m\,v\,r_{\mathrm{path}}}{c_{f}\,L}",
    "1/T sum_k cost(y_k)": r"\frac{1}{T}\,\sum_{k}\,\mathrm{cost}( y_{k} )",
    "rear r/max(v, 1 m/s)": r"\mathrm{rear}\;\frac{r}{\max( v , 1\,\mathrm{m/s} )}",
    "with probability dt/jump_time": r"\text{with } \mathrm{probability}\;\frac{\mathrm{d}t}{\mathrm{jump\_time}}",
    "a/b + c": r"\frac{a}{b} + c",
    "f(a) b/c d": r"\frac{f( a )\,b}{c}\,d",
    "exp(-dt/lag)": r"\exp\left( - \frac{\mathrm{d}t}{\mathrm{lag}} \right)",
    "sqrt(1 - f^2) n": r"\sqrt{1 - f^{2}}\,n",
    "x_{k+1} <= |x_k[5]|": r"x_{k + 1} \le \lvert x_{k}[ 5 ] \rvert",
    "1/|s - s'| + 2 |s|": r"\frac{1}{\lvert s - s' \rvert} + 2\,\lvert s \rvert",
    "sum_{i<m} gamma^i min_b q(s, b)": r"\sum_{i < m}\,\gamma^{i}\,\min_{b}\,q( s , b )",
    "tanh^2(e*w)": r"\tanh^{2}( e\,w )",
    "s <- e_dot += -+a_y_max": r"s \leftarrow \dot{e} \mathrel{+}= \mp a_{y,\mathrm{max}}",
    "L = l_f + l_r [m]": r"L = l_{f} + l_{r}\,\ \mathrm{[m]}",
    "dkappa/dt": r"\frac{\mathrm{d}\kappa }{\mathrm{d}t}",
    "c = 0 if |e| < goal and a = 0": r"c = 0 \text{ if } \lvert e \rvert < \mathrm{goal} \text{ and } a = 0",
}


@pytest.mark.parametrize("line", CASES)
def test_a_line_becomes_tex(tools: tuple[ModuleType, ModuleType], line: str) -> None:
    formulas, _ = tools
    assert re.sub(r" +", " ", formulas.tex(line)) == CASES[line]


@pytest.mark.parametrize("line", ["a = (b + c", "a = b)", "a = /b", "a = b/", "a = b_{c", 'a = "b"', "a = |b"])
def test_what_is_no_equation_is_refused_and_shown(tools: tuple[ModuleType, ModuleType], line: str) -> None:
    formulas, _ = tools
    with pytest.raises(formulas.FormulaError, match=re.escape(repr(line))):
        formulas.typeset(line)


def test_equations_of_docstrings_become_formulas_and_what_stands_after_two_colons_does_not(
    tools: tuple[ModuleType, ModuleType],
) -> None:
    _, docstrings = tools
    text = 'One <b> |e| $2.\n\n    e = a/b\n        + c,  if so\n\nThen::\n\n    run "a/b"\n\n    more\n\nv = 2 x'
    shown = docstrings.as_markdown(text)
    assert re.findall(r'data-tex="([^"]*)"', shown) == [r"e = \frac{a}{b} + c ,", "v = 2\\,x"]
    assert shown.startswith("One &lt;b&gt; \\|e\\| \\$2.\n\n<div")
    assert 'Then:\n\n```text\nrun "a/b"\n```\n\n```text\nmore\n```' in shown
    assert "<noscript><pre>e = a/b&#10;    + c,  if so</pre></noscript>" in shown  # still there as it was written


def test_every_equation_of_a_docstring_can_be_typeset_and_only_what_is_none_is_left_as_it_is(
    tools: tuple[ModuleType, ModuleType],
) -> None:
    _, docstrings = tools
    count, literal = 0, set()
    for name, text in written():
        shown = docstrings.as_markdown(text)  # raises for a line that is not understood
        count += shown.count('<div class="equations">')
        if "```" in shown:
            literal.add(name)
    assert literal == LITERAL, "an indented block is an equation unless `::` stands before it"
    assert count >= 60


def test_the_library_that_typesets_is_shipped_with_its_licence_and_only_what_the_site_needs() -> None:
    folder = ROOT / "docs" / "katex"
    style = (folder / "katex.min.css").read_text("utf-8")
    needed = {f"fonts/{name}" for name in re.findall(r"fonts/([\w-]+\.woff2)", style)}
    there = {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}
    assert there == needed | {"katex.min.js", "katex.min.css", "LICENSE"}
    assert "MIT License" in (folder / "LICENSE").read_text("utf-8")


@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome is installed, so no page was looked at in one")
def test_all_formulas_of_the_site_are_typeset_in_a_browser_from_the_disk_and_fit_a_telephone(tmp_path: Path) -> None:
    """The site as `make docs` builds it; its equations, put on one page of it, and what the browser made of them."""
    pytest.importorskip("mkdocs")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-d", str(site)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    pages = {str(page.relative_to(site)): page.read_text("utf-8") for page in sorted(site.rglob("*.html"))}
    blocks: list[str] = []
    for name, text in pages.items():
        found = re.findall(r'<div class="equations">.*?</noscript></div>', text, re.S)
        found += re.findall(r'<(div|span)( class="arithmatex">.*?)</\1>', text, re.S)
        blocks += [one if isinstance(one, str) else f"<{one[0]}{one[1]}</{one[0]}>" for one in found]
        if found:
            assert re.search(r'<script src="[./]*katex/katex.min.js">', text), name
            assert re.search(r'<script src="[./]*formulas.js">', text), name
            assert re.search(r'<link rel="stylesheet" href="[./]*katex/katex.min.css">', text), name
    assert sum("equations" in block for block in blocks) >= 60
    assert sum("arithmatex" in block for block in blocks) >= 60
    host = pages["mathematics.html"]
    begin, end = host.index(">", host.index("<article")) + 1, host.index("</article>")
    (site / "all.html").write_text(host[:begin] + "\n".join(blocks) + TELLS + host[end:], encoding="utf-8")
    (site / "frame.js").write_text(FRAME_JS, encoding="utf-8")
    (site / "frame.html").write_text(FRAME % ("frame.js", "all.html", 390, 900), encoding="utf-8")
    said = shown((site / "frame.html").as_uri(), tmp_path, "--hide-scrollbars")
    assert said["errors"] == []
    assert said["formulas"] == sum(block.count("data-tex=") + block.count("arithmatex") for block in blocks)
    assert said["width"] == 390, "a formula makes the page wider than the window"
    assert said["console"] == []
