"""Hooks of the documentation site: the API reference from the modules there are, and nothing loaded from elsewhere."""

from __future__ import annotations

import ast
import logging
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File
from pymdownx.arithmatex import arithmatex_fenced_format

ROOT = Path(__file__).parents[2]
GROUPS: dict[str, tuple[str, ...]] = {
    "Blocks and loops": ("diagram",),
    "Compiled loops": ("compiled",),
    "Analysis": ("analysis",),
    "Paths and courses": ("paths",),
    "Vehicles and plants": ("vehicles", "plants", "doe"),
    "Estimators": ("estimators",),
    "Controllers": ("controllers",),
    "Scenarios": ("scenario", "task"),
    "Metrics": ("metrics",),
    "Pictures": ("plots",),
    "Learning": ("learning",),
    "Gymnasium": ("gym",),
    "Logs and identification": ("logs", "identification"),
    "Manoeuvres": ("proving",),
    "Export": ("export",),
    "Real car": ("car",),
    "Command line": ("cli",),
    "Support": ("_support",),
}
"""Pages of the reference, by modules and packages of steerkit; a longer name goes before a shorter."""
PLATFORMS = "<!-- platforms -->"
"""The mark of the table of production cars in a page."""
FOREIGN = re.compile(r"""<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=["']?(?:https?:)?//[^"'\s>]+""")
log = logging.getLogger("mkdocs.hooks.site")


def modules() -> dict[str, list[str]]:
    """Page title -> the modules on it: all of steerkit that has a docstring, and no private name."""
    pages: dict[str, list[str]] = {title: [] for title in GROUPS}
    home = {name: title for title, names in GROUPS.items() for name in names}
    for file in sorted((ROOT / "steerkit").rglob("*.py")):
        parts = file.relative_to(ROOT / "steerkit").with_suffix("").parts
        name = ".".join(parts).removesuffix(".__init__")
        if name in ("__init__", "__main__") or not ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))):
            continue
        prefixes = [".".join(name.split(".")[:n]) for n in range(name.count(".") + 1, 0, -1)]
        title = next((home[prefix] for prefix in prefixes if prefix in home), None)
        if title is None:
            log.warning("steerkit.%s is on no page of the reference: name it in GROUPS (docs/tools/site.py)", name)
        else:
            pages[title].append(name)
    return {title: names for title, names in pages.items() if names}


def _slug(title: str) -> str:
    return re.sub(r"\W+", "-", title.lower())


def on_config(config: Any) -> Any:
    """Puts the pages of the reference where the navigation says `reference/`, leaves out pages not written yet, and has
    blocks of ```math typeset, as GitHub does."""
    here = [{title: f"reference/{_slug(title)}.md"} for title in modules()]
    nav = [{name: here if page == "reference/" else page for name, page in entry.items()} for entry in config.nav]
    for entry in nav:
        for name, page in entry.items():
            if isinstance(page, list) and page is not here:
                entry[name] = [one for one in page if _written(config, one)]
    config.nav = nav
    fence = {"name": "math", "class": "arithmatex", "format": arithmatex_fenced_format(mode="generic")}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}
    return config


def _written(config: Any, entry: dict[str, str]) -> bool:
    missing = [page for page in entry.values() if not (Path(config.docs_dir) / page).exists()]
    for page in missing:
        log.info("%s is in the navigation and not written yet", page)
    return not missing


def on_files(files: Any, config: Any) -> Any:
    """Adds a page for each group of modules."""
    for title, names in modules().items():
        text = f"# {title}\n\n" + "\n\n".join(f"::: steerkit.{name}" for name in names) + "\n"
        files.append(File.generated(config, f"reference/{_slug(title)}.md", content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Puts the table of production cars where the page has its mark."""
    return markdown.replace(PLATFORMS, _platforms()) if PLATFORMS in markdown else markdown


def _platforms() -> str:
    from steerkit.car.production.platforms import AT, rows

    try:
        found = rows()
    except ValueError as error:  # opendbc does not run on every Python
        return f"The table is not here: {error}"
    head = f"platform | by | from [m/s] | delay [s] | a_y at {AT:g} m/s [m/s²] | its rate [m/s³]"
    lines = [head, "|".join(["---"] * 6)]
    for row in found:
        if row["obstacle"]:
            lines.append(f"{row['name']} | not steered: {row['obstacle']} | | | |")
        else:
            numbers = (
                f"{row[key]:.{digits}f}" for key, digits in (("slowest", 1), ("delay", 2), ("a_y", 1), ("jerk", 1))
            )
            lines.append(" | ".join((row["name"], row["by"], *numbers)))
    return "\n".join(f"| {line} |" for line in lines)


def on_post_page(output: str, page: Any, config: Any) -> str:
    """A page that would load something from another host is an error in `--strict`."""
    for found in FOREIGN.findall(output):
        log.warning("%s loads from elsewhere: %s", page.file.src_uri, found)
    return output
