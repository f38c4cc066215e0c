"""XML that is read piece by piece, and what is done to harm."""

import tracemalloc
from pathlib import Path as FilePath
from xml.etree.ElementTree import Element

import pytest

from steerkit.paths.importers.xml_stream import get, number, records, value

BOMB = """<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "aaaaaaaaaa">
<!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]><gpx><name>&c;</name></gpx>"""
OUTSIDE = '<?xml version="1.0"?><!DOCTYPE gpx [<!ENTITY x SYSTEM "file:///etc/passwd">]><gpx><name>&x;</name></gpx>'


def of(text: str, tmp_path: FilePath, *wanted: str, begun: tuple[str, ...] = ()) -> list[Element]:
    file = tmp_path / "a.xml"
    file.write_text(text, encoding="utf-8")
    return [*records(file, wanted, begun)]


def test_elements_come_whole_or_where_they_begin(tmp_path: FilePath) -> None:
    text = '<m xmlns:k="u"><k:trk/><p a="1"><q>2.5</q><q/></p><trk/><p a="x"/></m>'
    trk, first, again, last = of(text, tmp_path, "p", begun=("trk",))
    assert (trk.tag, again.tag) == ("trk", "trk")
    assert number(first, "a") == 1.0
    assert [q.text for q in first.findall("q")] == ["2.5", None]
    assert value(first.findall("q")[0]) == 2.5
    with pytest.raises(ValueError, match=r'<p a="x"> a: is \'x\', expected a number'):
        number(last, "a")
    with pytest.raises(ValueError, match='<p a="x"> has no b'):
        get(last, "b")
    assert number(last, "b", 7.0) == 7.0


@pytest.mark.parametrize("text", ["inf", "nan", "1_0", "", "1,5", "0x10"])
def test_what_is_no_number_is_refused(text: str, tmp_path: FilePath) -> None:
    (node,) = of(f'<p a="{text}">{text}</p>', tmp_path, "p")
    for read in (lambda: number(node, "a"), lambda: value(node)):
        with pytest.raises(ValueError, match="expected a number"):
            read()


@pytest.mark.parametrize("text", [BOMB, OUTSIDE])
def test_entities_are_refused(text: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=r"declares entities .*which maps do not need and attacks do"):
        of(text, tmp_path, "name")


@pytest.mark.parametrize(
    "text", ["", "<a>", "no XML", "<a></b>", "<a>\x01</a>", '<?xml version="1.0" encoding="q-8"?><a/>']
)
def test_what_is_no_xml_is_refused(text: str, tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match="no XML, damaged or cut off"):
        of(text, tmp_path, "a")


def test_what_is_too_deep_is_refused(tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match="more than 100 elements within each other"):
        of("<a>" * 200 + "</a>" * 200, tmp_path, "a")


def test_a_large_file_takes_little_memory(tmp_path: FilePath) -> None:
    file = tmp_path / "a.xml"
    file.write_text("<m>" + '<p a="1.25" b="2.5"><q>text</q></p>' * 20_000 + "</m>", encoding="utf-8")
    tracemalloc.start()
    assert sum(1 for _ in records(file, ("p",))) == 20_000
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2 * file.stat().st_size
