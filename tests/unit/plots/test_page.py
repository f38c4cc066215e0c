"""A page is text between tags: only what is said to be markup is, and nothing is loaded."""

import base64
import re

from steerkit.plots.page import Html, document, html, picture, table
from steerkit.plots.style import new_figure


def test_only_what_is_said_to_be_markup_is() -> None:
    assert html("<b>'\"&") == "&lt;b&gt;&#x27;&quot;&amp;"
    assert html(Html("<b>x</b>")) == "<b>x</b>"
    assert html(html("<")) == "&lt;", "escaped once"
    cells = table(("<name>",), [(Html("<b>1</b>"),), (2.5,), ("<i>",)])
    assert "<th>&lt;name&gt;</th>" in cells
    assert re.findall(r"<td>(.*?)</td>", cells) == ["<b>1</b>", "2.5", "&lt;i&gt;"]


def test_a_page_is_whole_and_a_picture_is_in_it() -> None:
    text = document("a <b>", "<p>body</p>", command="x < y", closing="no <car>")
    assert text.startswith("<!DOCTYPE html>")
    for wanted in (
        "<title>a &lt;b&gt;</title>",
        "<p>body</p>",
        "<code>x &lt; y</code>",
        "no &lt;car&gt;",
        "@media print",
    ):
        assert wanted in text
    shown = picture(new_figure(1)[0], "it's <that>")
    data = re.search(r"src='data:image/png;base64,([^']*)'", shown)
    assert data
    assert base64.b64decode(data[1]).startswith(b"\x89PNG")
    assert "alt='it&#x27;s &lt;that&gt;'" in shown
    assert "<figcaption>it&#x27;s &lt;that&gt;</figcaption>" in shown
