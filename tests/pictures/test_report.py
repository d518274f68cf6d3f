"""Reports: whole HTML that needs nothing from elsewhere, in which every text stands as it was given."""

import base64
from html.parser import HTMLParser

from deformscope.pictures.report import Code, Figure, ReportVerdict, Section, Table, html_report

EVIL = '<script>alert("x")</script> & </style> \'"'


class Page(HTMLParser):
    """What a browser would see: tags that are closed in order, attributes, words."""

    VOID = ("meta", "img")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data

    def assert_self_contained(self) -> None:
        assert not {"script", "link", "iframe", "object", "form"} & set(self.tags)
        for name, value in self.attributes:
            assert not name.startswith("on")
            if name in ("src", "href", "srcset", "action", "background"):
                assert value.startswith("data:image/png;base64,")
        assert "url(" not in self.words
        assert "@import" not in self.words


def test_every_text_is_escaped_and_nothing_is_fetched() -> None:
    png = b"\x89PNG and so on"
    parts = [
        EVIL,
        ReportVerdict(EVIL, (EVIL,), "#123456"),
        Table([(EVIL, 1.5)], (EVIL, "b"), EVIL),
        Table([(EVIL, EVIL)]),
        Figure(png, EVIL),
        (Figure(png, EVIL), Figure(png, "second")),
        Code(EVIL),
    ]
    page = Page(html_report(EVIL, [Section(EVIL, parts), Section("", ["words"])]))
    page.assert_self_contained()
    assert page.words.count(EVIL) == 14
    assert sum(name == "alt" and value == EVIL for name, value in page.attributes) == 2
    pictures = [value.split(",")[1] for name, value in page.attributes if name == "src"]
    assert [base64.b64decode(one) for one in pictures] == [png] * 3
    assert page.tags.count("h2") == 1
    assert page.tags.count("th") == 3


def test_order_and_document() -> None:
    text = html_report("T", [Section("", [ReportVerdict("first", ())]), Section("second", ["third"])])
    assert text.startswith("<!DOCTYPE html>\n<html lang=")
    assert text.index("first") < text.index("second") < text.index("third")
