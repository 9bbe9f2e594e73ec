"""The page of all causes: what the unit itself says of each, for a technician without internet."""

import re
from collections.abc import Iterable
from html import escape

from altd.reasons import Reason
from altd.status.cause import Kind
from altd.status.conditions import Condition


def reasons_page(index: str) -> str:
    """Return the page from the tables of reasons and conditions, with each code as an anchor.

    Its head is that of ``index``, the unit's page, without scripts.
    """
    return f"""{index.partition("<script")[0]}</head>
<body>
<header><h1>Reasons</h1><nav aria-label="views"><a href="./">Active Laser Target</a></nav></header>
<main class="reasons">
{_section("The measurement is not valid", (reason for reason in Reason if not reason.is_warning))}
{_section("The measurement may be valid", (*(each for each in Reason if each.is_warning), *Condition))}
</main>
</body>
</html>
"""


def _section(title: str, kinds: Iterable[Kind]) -> str:
    entries = "\n".join(
        f'<li id="{kind}" class="{kind.signal}"><strong>{kind.brief}</strong>'
        f'<span class="remedy">{_html(kind.remedy)}</span>'
        f"<small>{_html(kind.meaning)}; <code>{kind}</code>, {kind.signal.replace('_', ' ')}</small></li>"
        for kind in kinds
    )
    return f'<section class="causes wide"><h2>{title}</h2><ul>\n{entries}\n</ul></section>'


def _html(markdown: str) -> str:
    """Return a text of the tables, whose only Markdown is that of code."""
    return re.sub("`(.*?)`", r"<code>\1</code>", escape(markdown))
