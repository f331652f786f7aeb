"""Reads the page of a report."""

import json
from html.parser import HTMLParser


class Elements(HTMLParser):
    """Tags and texts of a page, and its figures by name."""

    def __init__(self, path):
        super().__init__()
        self.tags, self.texts, self._is_data, self.figures = [], [], False, {}
        self.feed(path.read_text(encoding="utf-8"))

    @property
    def text(self):
        return "\n".join(self.texts)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._is_data = dict(attributes).get("id") == "figures"

    def handle_data(self, data):
        if self._is_data:
            self.figures = json.loads(data)
            self._is_data = False
        else:
            self.texts.append(data)
