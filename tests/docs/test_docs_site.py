"""The site: built as `make docs` builds it, every page within reach, no link to nowhere, nothing from elsewhere."""

from __future__ import annotations

import inspect
import itertools
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from urllib.parse import unquote, urldefrag, urlsplit

import pytest
from markdown_it import MarkdownIt
from myst_parser.mdit_to_docutils.base import default_slugify
from pages import DOCS, PAGES, ROOT, WRITTEN_BY_PROGRAMS

EXCLUDED = {"comparison/comparison.md", "comparison/C1/comparison.md", "comparison/hard/comparison.md"}
SHOWN = [page for page in PAGES if page not in EXCLUDED]


class Page(HTMLParser):
    """What a page of the site holds."""

    def __init__(self, path):
        super().__init__()
        self.ids, self.links, self.sources, self.scripts = set(), [], [], []
        self.text, self.article = [], []
        self._skipped, self._in_article = 0, False
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attributes):
        """Collects anchors, links and what is loaded."""
        result = dict(attributes)
        self.ids.update(filter(None, (result.get("id"), result.get("name"))))
        if tag == "a" and result.get("href"):
            self.links.append(result["href"])
        if tag in ("img", "script", "link", "source", "iframe"):
            self.sources += [result[key] for key in ("src", "href") if result.get(key)]
        self._skipped += tag in ("script", "style")
        self._in_article |= tag == "article"

    def handle_endtag(self, tag):
        """Leaves what holds no text."""
        self._skipped -= tag in ("script", "style")
        self._in_article &= tag != "article"

    def handle_data(self, data):
        """Collects text that is there without JavaScript."""
        if not self._skipped:
            self.text.append(data)
            if self._in_article:
                self.article.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site; the command is the Makefile's."""
    folder = tmp_path_factory.mktemp("site")
    makefile = (ROOT / "Makefile").read_text("utf-8")
    recipe = re.search(r"^docs:.*\n\t\$\(BIN\)/(sphinx-build .*) docs build/docs$", makefile, re.MULTILINE)
    arguments = shlex.split(recipe[1])
    assert {"-W", "--keep-going", "-n"} <= set(arguments)
    command = [
        sys.executable,
        "-m",
        "sphinx",
        *arguments[1:],
        "-d",
        str(folder / "trees"),
        "docs",
        str(folder / "html"),
    ]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder / "html"


@pytest.fixture(scope="module")
def pages(site):
    """Every page of it, by its path."""
    return {path.relative_to(site).as_posix(): Page(path) for path in site.rglob("*.html")}


def target(page, link):
    """Returns the path of the file that a link of a page leads to, and the anchor in it."""
    path, anchor = urldefrag(link)
    parts = [*page.split("/")[:-1], *unquote(path).split("/")] if path else page.split("/")
    result = []
    for part in parts:
        result = result[:-1] if part == ".." else result if part == "." else [*result, part]
    return "/".join(result), unquote(anchor)


def outside(link):
    return bool(urlsplit(link).scheme or urlsplit(link).netloc)


def anchors(page):
    """Returns the anchors of a page's source, as myst-parser makes them of headings up to the fourth level."""
    tokens = MarkdownIt().parse((DOCS / page).read_text("utf-8"))
    heads = [after for token, after in itertools.pairwise(tokens) if token.type == "heading_open"]
    texts = ["".join(part.content for part in head.children) for head in heads]
    return {default_slugify(text) for text in texts}


@pytest.mark.parametrize("page", PAGES)
def test_links_between_sources_lead_somewhere(page):
    """The nightly build checks those of the reference, too."""
    for inline in MarkdownIt().parse((DOCS / page).read_text("utf-8")):
        for part in inline.children or ():
            link = part.attrGet("href") or part.attrGet("src")
            if not link or outside(link):
                continue
            path, anchor = map(unquote, urldefrag(link))
            assert ((DOCS / page).parent / path).exists(), link
            assert not anchor or anchor in anchors(target(page, link)[0]), link


@pytest.mark.nightly
def test_every_page_is_within_reach_of_home(pages):
    reached, waiting = set(), ["index.html"]
    while waiting:
        page = waiting.pop()
        if page in reached or page not in pages:
            continue
        reached.add(page)
        waiting += [target(page, link)[0] for link in pages[page].links if not outside(link)]
    assert {page.removesuffix(".md") + ".html" for page in SHOWN} <= reached


@pytest.mark.nightly
def test_every_link_and_picture_leads_somewhere(site, pages):
    lost = []
    for name, page in pages.items():
        for link in [*page.links, *page.sources]:
            if outside(link):
                continue
            path, anchor = target(name, link)
            known = path not in pages or not anchor or anchor in pages[path].ids
            if not (site / path.split("?")[0]).is_file() or not known:
                lost.append(f"{name}: {link}")
    assert not lost


@pytest.mark.nightly
def test_links_to_elsewhere_are_https_and_well_formed(pages):
    for name, page in pages.items():
        for link in filter(outside, page.links):
            parts = urlsplit(link)
            assert parts.scheme == "https", f"{name}: {link}"
            assert re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.netloc), f"{name}: {link}"
            assert not re.search(r"\s", link), f"{name}: {link}"


@pytest.mark.nightly
def test_nothing_is_loaded_from_elsewhere(site, pages):
    for name, page in pages.items():
        assert not list(filter(outside, page.sources)), name
    for style in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", style.read_text("utf-8")), style.name


@pytest.mark.nightly
@pytest.mark.parametrize("page", SHOWN)
def test_text_and_navigation_are_there_without_javascript(page, pages):
    name = page.removesuffix(".md") + ".html"
    shown = pages[name]
    title = re.search(r"^# (.*)$", (DOCS / page).read_text("utf-8"), re.MULTILINE)[1]
    assert title in "".join(shown.article)
    assert len("".join(shown.article).split()) > 30
    targets = {target(name, link)[0] for link in shown.links if not outside(link)}
    assert {"index.html", "start.html", "world.html", "api/index.html"} <= targets


@pytest.mark.nightly
def test_the_reference_writes_arrays_as_the_source_does(pages):
    world = "".join(pages["api/world.html"].text)
    assert "Float[Array, 'robots 2 *batch']" in world
    assert "PRNGKeyArray" in world
    assert "jaxlib" not in world


@pytest.mark.nightly
def test_the_reference_has_every_public_name(pages):
    import murmurate.analysis
    import murmurate.discovery
    import murmurate.geometry
    import murmurate.learning
    import murmurate.plots
    import murmurate.policies
    import murmurate.world

    for name in ("analysis", "discovery", "geometry", "learning", "plots", "policies", "world"):
        package = getattr(murmurate, name)
        values = {public: getattr(package, public) for public in package.__all__}
        documented = {public for public, value in values.items() if inspect.isclass(value) or inspect.isroutine(value)}
        assert {f"murmurate.{name}.{public}" for public in documented} <= pages[f"api/{name}.html"].ids


@pytest.mark.parametrize("page", [page for page in SHOWN if page not in WRITTEN_BY_PROGRAMS])
def test_pages_name_no_place_of_a_machine(page):
    text = (DOCS / page).read_text("utf-8")
    assert not re.search(r"(?<![\w.])/(work|home|root|tmp|usr)/", text)
    assert max(map(len, text.splitlines())) <= 180
