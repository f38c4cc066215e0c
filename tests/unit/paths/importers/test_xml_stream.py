"""XML that is read piece by piece, and what is done to harm."""

from __future__ import annotations

import tracemalloc
from pathlib import Path as FilePath

import pytest

from steerkit.paths.importers.xml_stream import Node, records, root_of

BOMB = """<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "aaaaaaaaaa">
<!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]><gpx><name>&c;</name></gpx>"""
OUTSIDE = '<?xml version="1.0"?><!DOCTYPE gpx [<!ENTITY x SYSTEM "file:///etc/passwd">]><gpx><name>&x;</name></gpx>'


def of(text: str, tmp_path: FilePath, wanted: set[str], marks: set[str] = frozenset()) -> list[Node | str]:  # type: ignore[assignment]
    file = tmp_path / "a.xml"
    file.write_text(text, encoding="utf-8")
    return [*records(file, wanted, marks)]


def test_elements_come_whole_and_marks_in_between(tmp_path: FilePath) -> None:
    text = '<m xmlns:k="u"><k:trk/><p a="1"><q>2.5</q><q/></p><trk/><p a="x"/></m>'
    trk, first, again, last = of(text, tmp_path, {"p"}, {"trk"})
    assert (trk, again) == ("trk", "trk")
    assert isinstance(first, Node)
    assert isinstance(last, Node)
    assert first.number("a") == 1.0
    assert [q.text for q in first.all("q")] == ["2.5", ""]
    found = first.find("q")
    assert found is not None
    assert found.value() == 2.5
    assert first.find("q", "r") is None
    with pytest.raises(ValueError, match=r"a.xml, line 1: <p> a: is 'x', expected a number"):
        last.number("a")
    with pytest.raises(ValueError, match="<p> has no b; it has a"):
        last.get("b")
    assert last.number("b", 7.0) == 7.0


@pytest.mark.parametrize("text", ["inf", "nan", "1_0", "", "1,5", "0x10"])
def test_what_is_no_number_is_refused(text: str, tmp_path: FilePath) -> None:
    (node,) = of(f'<p a="{text}"/>', tmp_path, {"p"})
    assert isinstance(node, Node)
    with pytest.raises(ValueError, match="expected a number"):
        node.number("a")


@pytest.mark.parametrize("text", [BOMB, OUTSIDE])
def test_entities_are_refused(text: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=r"declares entities .*which maps do not need and attacks do"):
        of(text, tmp_path, {"name"})


@pytest.mark.parametrize(
    "text", ["", "<a>", "no XML", "<a></b>", "<a>\x01</a>", '<?xml version="1.0" encoding="q-8"?><a/>']
)
def test_what_is_no_xml_is_refused(text: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match="no XML, damaged or cut off"):
        of(text, tmp_path, {"a"})


def test_what_is_too_deep_is_refused(tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match="more than 100 elements within each other"):
        of("<a>" * 200 + "</a>" * 200, tmp_path, {"a"})


def test_a_large_file_takes_little_memory(tmp_path: FilePath) -> None:
    file = tmp_path / "a.xml"
    file.write_text("<m>" + '<p a="1.25" b="2.5"><q>text</q></p>' * 20_000 + "</m>", encoding="utf-8")
    tracemalloc.start()
    assert sum(isinstance(node, Node) for node in records(file, {"p"})) == 20_000
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2 * file.stat().st_size


def test_the_root_tells_the_kind(tmp_path: FilePath) -> None:
    file = tmp_path / "a.xml"
    file.write_text('<?xml version="1.0"?>\n<!-- map --><k:osm version="0.6"/>', encoding="utf-8")
    assert root_of(file) == "osm"
    file.write_text("plain", encoding="utf-8")
    with pytest.raises(ValueError, match="is no XML"):
        root_of(file)
    with pytest.raises(ValueError, match="cannot be read"):
        root_of(tmp_path / "none.xml")
