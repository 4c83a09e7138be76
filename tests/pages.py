"""HTML pages as tests read them."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Tags with their attributes, the text, and scripts by their types; refuses tags that do not match."""

    VOID = ("meta", "img", "br", "input", "link")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.tags, self.text, self.scripts = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)
        if self.open[-1:] == ["script"]:
            self.scripts.append((self.tags[-1][1].get("type", ""), data))

    @property
    def sources(self) -> list[str]:
        """What is fetched from elsewhere, or linked."""
        names = ("src", "href", "srcset", "data", "action")
        return [value for _, given in self.tags for name, value in given.items() if name in names]
