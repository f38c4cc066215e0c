"""A page is text between tags: only what is said to be markup is, and nothing is loaded."""

import base64
import re

from steerkit.plots.page import Html, html, picture, table
from steerkit.plots.style import new_figure


def test_only_what_is_said_to_be_markup_is() -> None:
    assert html("<b>'\"&") == "&lt;b&gt;&#x27;&quot;&amp;"
    assert html(Html("<b>x</b>")) == "<b>x</b>"
    assert html(html("<")) == "&lt;", "escaped once"
    cells = table(("<name>",), [(Html("<b>1</b>"),), (2.5,), ("<i>",)])
    assert "<th>&lt;name&gt;</th>" in cells
    assert re.findall(r"<td>(.*?)</td>", cells) == ["<b>1</b>", "2.5", "&lt;i&gt;"]


def test_a_picture_is_in_the_page_and_says_what_it_is() -> None:
    shown = picture(new_figure(1)[0], "it's <that>")
    data = re.search(r"src='data:image/png;base64,([^']*)'", shown)
    assert data
    assert base64.b64decode(data[1]).startswith(b"\x89PNG")
    assert "alt='it&#x27;s &lt;that&gt;'" in shown
    assert "<figcaption>it&#x27;s &lt;that&gt;</figcaption>" in shown
