"""Check that a page explains its content: a sentence and a working link for every table head and every name."""

from __future__ import annotations

import html
import re

_MOST_WORDS = 25


def one_sentence(words: str) -> bool:
    """Return True if the words are one sentence or question of at most 25 words."""
    return bool(re.fullmatch(r"\S(?:(?![.?] [A-Z]).)*[.?]", words)) and len(words.split()) <= _MOST_WORDS


def unexplained(page: str) -> list[str]:
    """Heads, and names of checks and causes, without a link to an explanation of one sentence."""
    ids = re.findall(r'<[^<>]* id="([^"]+)"', page)
    missing = [f"two elements are {one}" for one in set(ids) if ids.count(one) > 1]
    missing += [f"{head} has no link" for head in re.findall(r'<th scope="col">((?!<a class="defined").*?)</th>', page)]
    for place, title, text in re.findall(r'<a class="defined" href="#([^"]+)" title="([^"]*)">([^<]*)</a>', page):
        if place not in ids or not one_sentence(html.unescape(title)):
            missing.append(f"{text}: {place}, {title}")
    return missing


def unlinked(page: str, kind: str) -> list[str]:
    """Names of a kind (check, cause) in the page's tables without a link, except those of the reference itself."""
    head = rf'<th scope="col"><a [^>]*>{kind}</a></th>'
    names = []
    for table in re.findall(r"<table.*?</table>", page, re.DOTALL):
        heads = re.findall(r"<th.*?</th>|<td></td>", table.partition("</thead>")[0])
        columns = [k for k, one in enumerate(heads) if re.fullmatch(head, one)]
        rows = re.findall(r"<tr(?! id=).*?</tr>", table.partition("<tbody>")[2], re.DOTALL)
        cells = [re.findall(r"<td>(.*?)</td>", row, re.DOTALL) for row in rows]
        names += [row[k] for row in cells for k in columns if not row[k].startswith("<a ")]
    return names
