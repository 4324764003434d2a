"""`report.html` and `view.html`: for one release they lead to the page that has taken their place."""

from __future__ import annotations

from typing import Final

from gaitcal.page.policy import policy

FORMER: Final = ("report.html", "view.html")
"""Names that the pages of a result had."""

_TEMPLATE: Final = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>gaitcal: moved to {target}</title>
<noscript><meta http-equiv="refresh" content="0; url={target}"></noscript>
</head>
<body>
<p>Report and view are one page now: <a href="{target}">{target}</a>. This file leads there for one release.</p>
<script>{script}</script>
</body>
</html>
"""


def redirect_html(target: str) -> str:
    """A page that leads to the file `target` beside it, with what stands behind the `#` of its own address."""
    script = f'location.replace("{target}" + location.hash);'
    return _TEMPLATE.format(policy=policy(script), target=target, script=script)
