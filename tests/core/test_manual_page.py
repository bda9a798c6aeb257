"""The manual's pages as web pages."""

from pathlib import Path

import pytest
from crowd_lod_extension.crowd_lod.reporting.manual_page import anchor_of, manual_page

from ..support.pages import Reader

DOCS = Path(__file__).parents[2] / "docs"


def test_markdown_is_told_as_html():
    page = manual_page(
        "# The *sidebar*\n\nPress **Plan** ([how](shot_plan.md#budgets)), `a < b`.\nAgain.\n\n"
        "- one\n  goes on\n- two\n\n| a | b |\n| --- | ---: |\n| `x` | 1 < 2 |\n\n"
        "```sh\n# no heading\n```\n"
    )
    assert '<h1 id="the-sidebar">The <i>sidebar</i></h1>' in page
    assert '<p>Press <b>Plan</b> (<a href="shot_plan.html#budgets">how</a>), ' in page
    assert "<code>a &lt; b</code>. Again.</p>" in page
    assert "<ul><li>one goes on</li><li>two</li></ul>" in page
    assert "<td><code>x</code></td><td>1 &lt; 2</td>" in page
    assert "<pre># no heading</pre>" in page


@pytest.mark.parametrize("name", sorted(path.name for path in DOCS.glob("*.md")))
def test_pages_become_whole_web_pages(name):
    text = (DOCS / name).read_text()
    page = manual_page(text)
    Reader(page)
    headings = [line for line in text.split("```")[0].splitlines() if line.startswith("#")]
    for heading in headings:
        assert f'id="{anchor_of(heading.lstrip("# "))}"' in page
    assert "](" not in page and "\0" not in page
