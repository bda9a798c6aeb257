"""Web pages, read back."""

from html.parser import HTMLParser

VOID = {"br", "img", "meta"}


class Reader(HTMLParser):
    """Tags that balance, texts of the cells, links and sources of the pictures, ids."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.tags = []
        self.cells = []
        self.links = []
        self.ids = []
        self.texts = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)
        if "td" in self.open or "th" in self.open:
            self.cells[-1] += data
