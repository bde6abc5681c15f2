"""Reads a report back: HTML with the standard library's parser, Markdown line by line."""

from __future__ import annotations

import html
import re
from html.parser import HTMLParser

VOID = {"meta", "img"}
INLINE = {"code", "b"}


class Page(HTMLParser):
    """An HTML file whose every tag is closed where it should be."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.attributes, self.said, self.text = [], [], [], {}, ""
        self.feed(text)
        self.close()
        assert self.open == []

    @property
    def words(self):
        """What a reader reads, but for the table of contents and the running head."""
        return self.text.split()

    def handle_starttag(self, tag, attrs):
        self.text += "" if tag in INLINE else " "
        self.tags.append(tag)
        self.attributes.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append((tag, dict(attrs).get("class")))

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> without a beginning"
        assert self.open.pop()[0] == tag
        self.text += "" if tag in INLINE else " "

    def handle_data(self, data):
        self.said.setdefault(self.open[-1] if self.open else None, []).append(data)
        tags = {tag for tag, _ in self.open}
        if not tags & {"style", "nav", "head"} and ("div", "running") not in self.open:
            self.text += data

    def of(self, tag, attribute):
        return [values[attribute] for name, values in self.attributes if name == tag and attribute in values]


def markdown_words(text):
    """The words of a Markdown file, without what makes it Markdown."""
    words = []
    for line in text.splitlines():
        if line.startswith("!["):
            continue
        line = re.sub(r"^(#+|>|-) ", "", line)
        if line.startswith("|"):
            if set(line) <= set("| -:"):
                continue
            line = " ".join(re.split(r"(?<!\\)\|", line))
        line = re.sub(r"^\*\*(.*)\*\*$|^\*(.*)\*$", lambda found: found[1] or found[2], line)
        words += re.sub(r"\\(.)", r"\1", line.replace("`", "")).split()
    return [html.unescape(word) for word in words]
