"""What a page of ours may do: run the scripts that stand in it, and nothing else."""

from __future__ import annotations

import base64
import hashlib


def policy(*scripts: str) -> str:
    """A Content-Security-Policy under which only these inline scripts run and nothing is requested."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'" for s in scripts)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def inline(script: str) -> str:
    """A script that may stand between `<script>` and `</script>`, and that a browser hashes as we do."""
    text = script.replace("\r\n", "\n").replace("\r", "\n")
    return text.replace("<!--", "<\\!--").replace("</script", "<\\/script").replace("</SCRIPT", "<\\/SCRIPT")
