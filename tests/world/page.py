"""Parse an HTML page with the standard library: its elements, and whether it is well formed."""

from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

WHOLE = {"html", "body", "main", "section"}  # their text would be that of the whole page
VOID = {"meta", "link", "img", "br", "hr", "input"}


@dataclass
class Element:
    """One element with the text inside it."""

    name: str
    attributes: dict[str, str | None]
    text: str = ""


@dataclass
class Document(HTMLParser):
    """A parsed page; an element that is not closed, or closed twice, raises an AssertionError."""

    elements: list[Element] = field(default_factory=list)

    def __post_init__(self):
        super().__init__(convert_charrefs=True)
        self._open: list[Element] = []

    def handle_starttag(self, tag, attrs):
        assert len({name for name, _ in attrs}) == len(attrs), f"an attribute twice in {self.get_starttag_text()[:200]}"
        self.elements.append(Element(tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(self.elements[-1])

    def handle_endtag(self, tag):
        assert self._open and self._open.pop().name == tag, f"</{tag}> in line {self.getpos()[0]} closes nothing"

    def handle_data(self, data):
        for element in self._open:
            if element.name not in WHOLE:
                element.text += data

    def all(self, *names: str) -> list[Element]:
        """List the elements of these names in page order."""
        return [one for one in self.elements if one.name in names]


def read(path: Path) -> Document:
    """Parse a page from a file."""
    document = Document()
    document.feed(path.read_text(encoding="utf-8"))
    document.close()
    assert not document._open, f"never closed: {[one.name for one in document._open]}"
    return document
