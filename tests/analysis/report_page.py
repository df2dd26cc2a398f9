"""What tests want to know of the page of a report."""

import re
from html.parser import HTMLParser

ALL_SECTIONS = [
    "provenance", "study", "flow", "states", "model", "uncertainty", "comparison", "people", "held-out",
    "regression", "anova", "power", "reward", "plan", "robust", "sensitivity", "safeguards", "study2", "paper",
    "evidence", "limits", "appendix",
]  # fmt: skip


class Page(HTMLParser):
    """Tags, ids, links, levels of headings, and the badges of every caption."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.links, self.badges = [], [], [], []
        self.headings, self.captions = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if "id" in attrs:
            self.ids.append(attrs["id"])
        self.links += [v for k, v in attrs.items() if k in ("src", "href", "xlink:href", "data", "action")]
        if re.fullmatch(r"h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag == "figcaption" or attrs.get("class") == "caption":
            self.captions.append([])
        if "badge" in attrs.get("class", "").split() and self.captions:
            self.captions[-1].append(attrs["class"].split()[-1])
