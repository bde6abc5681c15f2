"""Reads an HTML report back with the standard library's parser."""

from __future__ import annotations

from html.parser import HTMLParser

VOID = {"meta", "img"}
INLINE = {"code", "b", "em", "strong"}


class Page(HTMLParser):
    """An HTML file whose every tag is closed where it should be."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.attributes, self.texts = [], [], [], {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag not in VOID | INLINE:
            self.texts.setdefault(tag, []).append("")

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> without a beginning"
        assert self.open.pop() == tag

    def handle_data(self, data):
        block = next((tag for tag in reversed(self.open) if tag not in INLINE), None)
        if block:
            self.texts[block][-1] += data

    def of(self, tag, attribute):
        """Returns the values of an attribute."""
        return [values[attribute] for name, values in self.attributes if name == tag and attribute in values]
