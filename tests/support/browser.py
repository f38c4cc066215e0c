"""A real browser, without a window."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
FLAGS = """--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking
--disable-component-update --disable-sync --disable-dev-shm-usage --window-size=1500,1000 --enable-logging=stderr
--virtual-time-budget=10000"""
FRAME = """<!doctype html><pre id="probe"></pre><script src="%s"></script>
<iframe src="%s" width="%d" height="%d" frameborder="0"></iframe>"""
"""A page in a frame: no window is as narrow as a phone. Its script, FRAME_JS; the page; how large."""
FRAME_JS = """
addEventListener("message", event => { document.querySelector("pre").textContent = event.data; });
"""


def shown(frame: str, folder: Path, *options: str) -> dict[str, Any]:
    """What a page in a FRAME says of itself in one message with JSON to its parent; and the lines of the console.

    frame: the frame's address, of the same origin as the page. folder: for the browser's profile.
    """
    assert BROWSER is not None
    done = subprocess.run(
        [BROWSER, *FLAGS.split(), f"--user-data-dir={folder / 'profile'}", *options, "--dump-dom", frame],
        capture_output=True,
        text=True,
        timeout=120,
    )
    found = re.search(r'<pre id="probe">(.+?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-2000:]
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return dict(json.loads(html.unescape(found[1]))) | {"console": said}
