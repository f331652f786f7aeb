"""Reads the page of a report."""

import json
from html.parser import HTMLParser


class Elements(HTMLParser):
    """Tags and texts of a page, and its data."""

    def __init__(self, path):
        super().__init__()
        self.tags, self.texts = [], []
        self.feed(path.read_text(encoding="utf-8"))
        self.figures = json.loads(next(text for text in self.texts if text.startswith('{"x":')))

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.texts.append(data)
