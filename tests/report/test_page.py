"""A report page says what it was given, and nothing that it was given becomes markup."""

import base64
import hashlib
import re
from html.parser import HTMLParser
from importlib import util

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from tracker.errors import PluginError
from tracker.report import drawing, page

EVIL = '</td><script>alert(1)</script><img src=x onerror="go()">&amp;\'"'
OURS = {
    *(
        "html",
        "head",
        "meta",
        "title",
        "style",
        "body",
        "h1",
        "h2",
        "p",
        "ul",
        "li",
        "div",
        "table",
    ),
    *("thead", "tbody", "tr", "th", "td", "figure", "figcaption", "img"),
}


class Reader(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def built(words: str) -> str:
    pieces = [
        page.text(words),
        page.points([words]),
        page.table((words, "n"), [(words, "1"), ("b", "2")], words),
        page.figure(b"<svg/>", words, words),
    ]
    return page.page(words, [(words, pieces)])


def assert_harmless(text: str) -> None:
    for tag, attributes in Reader(text).tags:
        assert tag in OURS, tag
        assert not [name for name in attributes if name.startswith("on")], attributes
        assert str(attributes.get("src", "data:")).startswith("data:")
        assert "href" not in attributes


def test_markup_in_names_stays_text_everywhere() -> None:
    text = built(EVIL)
    assert_harmless(text)
    assert "<script" not in text
    # title, h1, h2, paragraph, point, head, cell, two captions
    assert "".join(Reader(text).words).count(EVIL) == 9


@given(st.text(max_size=40))
def test_no_text_whatever_becomes_markup(words: str) -> None:
    assert_harmless(built(words))


def test_the_page_forbids_everything_but_its_own_style_and_pictures() -> None:
    text = built("x")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)
    assert policy is not None
    assert style is not None
    digest = base64.b64encode(hashlib.sha256(style[1].encode()).digest()).decode()
    assert policy[1].startswith("default-src 'none'; ")
    assert f"style-src 'sha256-{digest}'" in policy[1]
    assert "unsafe" not in policy[1]
    assert "style=" not in text, "the policy would ignore it"
    assert "http:" not in text
    assert "https:" not in text


def test_columns_of_numbers_are_flush_right_and_others_are_not() -> None:
    text = page.table(("a", "b", "c"), [("x", "1.5", "12 %"), ("2", "-3", "n/a")])
    assert text.count('<td class="number">') == 2


def test_the_same_picture_gives_the_same_bytes_and_leaves_no_setting_behind() -> None:
    def draw() -> Figure:
        picture = Figure(figsize=(2, 2))
        picture.subplots().plot([0, 1], [0, 1], label="cost $5 and $6")
        return picture

    before = dict(mpl.rcParams)
    assert drawing.svg(draw) == drawing.svg(draw)
    assert drawing.png(draw).startswith(b"\x89PNG")
    assert dict(mpl.rcParams) == before


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        drawing, "find_spec", lambda name: None if name == "matplotlib" else util.find_spec(name)
    )
    with pytest.raises(PluginError, match=r"pip install 'tracker-lab\[plot\]'"):
        drawing.svg(Figure)


def test_the_ellipse_holds_95_percent() -> None:
    cov = np.array([[4.0, 1.0], [1.0, 2.0]])
    outline = drawing.ellipse(np.array([3.0, -1.0]), cov)
    apart = outline - np.array([[3.0], [-1.0]])
    distance = np.einsum("ip,ij,jp->p", apart, np.linalg.pinv(cov), apart)
    assert np.allclose(distance, -2.0 * np.log(0.05), atol=1e-3)
