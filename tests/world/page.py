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
    inside: tuple[str, ...] = ()  # names of the enclosing elements, outermost first


@dataclass
class Document(HTMLParser):
    """A parsed page; an element that is not closed, or closed twice, raises an AssertionError."""

    elements: list[Element] = field(default_factory=list)

    def __post_init__(self):
        super().__init__(convert_charrefs=True)
        self._open: list[Element] = []

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"an attribute twice in {self.get_starttag_text()[:200]}"
        element = Element(tag, dict(attrs), inside=tuple(one.name for one in self._open))
        self.elements.append(element)
        if tag not in VOID:
            self._open.append(element)

    def handle_endtag(self, tag):
        assert self._open and self._open[-1].name == tag, f"</{tag}> in line {self.getpos()[0]} closes nothing"
        self._open.pop()

    def handle_data(self, data):
        for element in self._open:
            if element.name not in WHOLE:
                element.text += data

    def close(self):
        super().close()
        assert not self._open, f"never closed: {[one.name for one in self._open]}"

    def all(self, *names: str) -> list[Element]:
        """List the elements of these names in page order."""
        return [one for one in self.elements if one.name in names]


def read(path: Path) -> Document:
    """Parse a page from a file."""
    return parse(path.read_text(encoding="utf-8"))


def parse(text: str) -> Document:
    """Parse a page from a string."""
    document = Document()
    document.feed(text)
    document.close()
    return document
