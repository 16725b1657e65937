"""The tree of XML that robots, meshes and MJCF models share: limits, encodings, namespaces, and what was not read."""

import pytest

from loewner._base import _xml


def parsed(data, **options):
    return _xml.parse(data, "a test", _xml.Element, **({"deepest": 5, "most": 20} | options))


def test_tree_has_attributes_lines_and_texts():
    """Elements are as in the file."""
    root = parsed(b'<a x="1">\n one <b/>\n two </a>', texts=True)
    (b,) = root.children
    assert (root.tag, root.line, root.attributes, "".join(root.texts).split()) == ("a", 1, {"x": "1"}, ["one", "two"])
    assert (b.tag, b.line, b.children, b.texts) == ("b", 2, [], [])
    assert parsed("<a>text</a>").texts == []


@pytest.mark.parametrize(
    ("data", "found", "line"),
    [
        (b"<a>\n</b>", "broken XML \\(mismatched tag\\)", 2),
        (b"", "broken XML", 1),
        (b"<a>\n" + b"<b>" * 5 + b"</b>" * 5 + b"</a>", "more than 5 elements inside each other", 2),
        (b"<a>" + b"\n<b/>" * 20 + b"</a>", "more than 20 elements", 21),
        (b'<!DOCTYPE a [\n<!ENTITY b "c">]>\n<a/>', "the declaration of an entity, 'b'", 2),
        (b"<?xml version='1.0' encoding='nonsense'?><a/>", "broken XML", 1),
        (b"<?xml version='1.0' encoding='gb2312'?><a b='\xff\xff'/>", "broken XML", 1),
        ("<a b='\ud800'/>", "broken XML", 1),
    ],
)
def test_what_is_no_xml_is_refused_with_its_line(data, found, line):
    """The error has the line of the fault."""
    with pytest.raises(_xml.XmlError, match=f"^expected a test, found {found}") as caught:
        parsed(data)
    assert caught.value.line == line


def test_document_types_are_refused_on_request():
    """Readers choose whether a document type may be there."""
    assert parsed(b"<!DOCTYPE a>\n<a/>").tag == "a"
    with pytest.raises(_xml.XmlError, match="found a document type"):
        parsed(b"<!DOCTYPE a>\n<a/>", doctype=False)


@pytest.mark.parametrize("codec", ["UTF-8", "UTF-16", "GB2312", "GB18030", "Shift_JIS", "EUC-JP", "Big5"])
def test_encodings_that_a_file_declares(codec):
    """The characters belong to all of these sets; expat itself decodes the first two only."""
    root = parsed(f'<?xml version="1.0" encoding="{codec}"?>\n<a b="山本"/>'.encode(codec))
    assert (root.get("b"), root.line) == ("山本", 2)


def test_text_is_decoded_already():
    """A text's declared encoding does not count."""
    assert parsed('<?xml version="1.0" encoding="GB2312"?><a b="é"/>').get("b") == "é"


def test_namespaces_are_in_scope_or_taken_off():
    """Prefixes resolve to the addresses in scope."""
    text = '<a xmlns="one"><x:b xmlns:x="two"><x:c/></x:b><x:d/><e/></a>'
    root = parsed(text)
    b, d, e = root.children
    places = [root, b, b.children[0], d, e]
    assert [(p.tag, p.namespace) for p in places] == [
        ("a", "one"),
        ("x:b", "two"),
        ("x:c", "two"),
        ("x:d", ""),
        ("e", "one"),
    ]
    root = parsed(text.replace("<x:d/>", ""), strip=True)
    assert [(p.tag, p.namespace) for p in [root, *root.children]] == [("a", "one"), ("b", "two"), ("e", "one")]


def test_children_that_may_occur_once():
    """A second one is refused."""
    root = parsed("<a>\n<b/>\n<b/><c/></a>")
    assert root.one("d") is None
    assert root.one("c") is root.the("c")
    with pytest.raises(_xml.XmlError, match="expected one <b> in <a>, found another one in line 2") as caught:
        root.one("b")
    assert caught.value.line == 3
    with pytest.raises(_xml.XmlError, match="expected a <d> in <a>, found none"):
        root.the("d")


def test_what_nobody_asked_for_is_reported_in_order():
    """Unread elements and attributes come in the order of the file."""
    root = parsed('<a x="1" y="2" xmlns:n="z"><b p="1">\n<q/></b><c><d/></c>\n<e f="1"><g/></e><b/><h/></a>')
    root.get("x")
    for b in root.all("b"):
        b.get("r")
    root.one("c")
    found = [(element.line, name) for element, name in root.unread({"a": {"e", "@z"}, "b": {"q"}})]
    assert found == [(1, "<a y>"), (1, "<b p>"), (2, "<d> in <c>"), (3, "<h> in <a>")]
