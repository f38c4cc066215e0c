// Typesets what docs/tools/formulas.py (docstrings) and arithmatex (pages) have left for KaTeX.
document.addEventListener("DOMContentLoaded", () => {
  const settings = { throwOnError: false, strict: "ignore" };
  for (const place of document.querySelectorAll("[data-tex]")) {
    katex.render("\\displaystyle " + place.dataset.tex, place, settings);
  }
  for (const place of document.querySelectorAll(".arithmatex")) {
    const [, opened, tex] = place.textContent.trim().match(/^(\\[([])([\s\S]*)\\[)\]]$/);
    katex.render(tex, place, { ...settings, displayMode: opened === "\\[" });
  }
});
