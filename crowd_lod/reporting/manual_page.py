"""Pages of the manual as web pages: as much of Markdown as our pages use."""

import re
from collections.abc import Iterator
from html import escape

from .html_report import STYLE, document

MANUAL_STYLE = """
body { max-width: 56rem } th, td { text-align: left; white-space: normal; vertical-align: top }
pre { background: var(--card); border: 1px solid var(--line); padding: .8rem; overflow-x: auto }
p, li { color: var(--ink) }
"""
LIST = re.compile(r"(- |\d+\. )")
BLOCK = re.compile(r"#|```|\||- |\d+\. ")  # begins another block than a paragraph


def manual_page(text: str) -> str:
    """Return the Markdown `text` as a web page; links to other pages lead to web pages, too."""
    lines = text.splitlines()
    title = next((line.lstrip("# ") for line in lines if line.startswith("#")), "Crowd LOD")
    return document(escape(title), STYLE + MANUAL_STYLE, list(_blocks(lines)))


def anchor_of(heading: str) -> str:
    """Return the anchor of a heading, as in links to it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _blocks(lines: list[str]) -> Iterator[str]:
    """Yield the HTML of each block: heading, code, table, list or paragraph."""
    at = 0
    while at < len(lines):
        begin = at
        line = lines[at]
        at += 1
        if line.startswith("#"):
            marks, _, heading = line.partition(" ")
            tag = f"h{min(len(marks), 3)}"
            yield f'<{tag} id="{anchor_of(heading)}">{_inline(heading)}</{tag}>'
        elif line.startswith("```"):
            while at < len(lines) and not lines[at].startswith("```"):
                at += 1
            at += 1
            yield f"<pre>{escape(chr(10).join(lines[begin + 1 : at - 1]))}</pre>"
        elif line.startswith("|"):
            while at < len(lines) and lines[at].startswith("|"):
                at += 1
            yield _table(lines[begin:at])
        elif LIST.match(line):
            while at < len(lines) and (LIST.match(lines[at]) or lines[at].startswith(" ")):
                at += 1
            yield _list(lines[begin:at])
        elif line.strip():
            while at < len(lines) and lines[at].strip() and not BLOCK.match(lines[at]):
                at += 1
            yield f"<p>{_inline(' '.join(lines[begin:at]))}</p>"


def _table(lines: list[str]) -> str:
    """Return a table; its second line only says how columns are aligned."""
    head, _, *rows = ([cell.strip() for cell in line.strip("| ").split("|")] for line in lines)
    top = "".join(f"<th>{_inline(cell)}</th>" for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{_inline(cell)}</td>" for cell in row) + "</tr>\n" for row in rows
    )
    return f'<div class="scroll"><table><tr>{top}</tr>\n{body}</table></div>'


def _list(lines: list[str]) -> str:
    """Return a list; lines that are indented go on with the item before."""
    items: list[str] = []
    for line in lines:
        mark = LIST.match(line)
        if mark:
            items.append(line[mark.end() :])
        else:
            items[-1] += f" {line.strip()}"
    tag = "ul" if lines[0].startswith("-") else "ol"
    return f"<{tag}>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + f"</{tag}>"


def _inline(text: str) -> str:
    """Return a line's text as HTML: code, pictures, links, bold and italic."""
    codes: list[str] = []

    def set_aside(match: re.Match[str]) -> str:
        codes.append(f"<code>{escape(match[1])}</code>")
        return f"\0{len(codes) - 1}\0"

    html = escape(re.sub(r"`([^`]+)`", set_aside, text), quote=False)
    html = html.replace("&lt;br&gt;", "<br>")
    html = re.sub(r"!\[([^]]*)\]\(([^)]+)\)", r'<img src="\2" alt="\1">', html)
    html = re.sub(r"\[([^]]*)\]\(([^)]+)\)", _link, html)
    html = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", html)
    html = re.sub(r"(?<!\w)\*(\S(?:.*?\S)?)\*(?!\w)", r"<i>\1</i>", html)
    return re.sub(r"\0(\d+)\0", lambda match: codes[int(match[1])], html)


def _link(match: re.Match[str]) -> str:
    text, target = match.groups()
    if "://" not in target:
        target = re.sub(r"\.md(?=#|$)", ".html", target)
    return f'<a href="{target}">{text}</a>'
