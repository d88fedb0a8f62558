"""The page of a window in a browser, and the keys that it keeps from the browser."""

from __future__ import annotations

import json
from html import escape

from supple.viewer.tools.gestures import COMMANDS

TAKEN = 4001
"""The code with which the connection of a page is closed whose window another page has taken over."""

# The focus of a canvas is an element of its own. Other keys of the window do nothing in a browser while that has it.
KEYS = f"""
window.addEventListener("keydown", (event) => {{
  const letter = {json.dumps(sorted(COMMANDS))}.includes(event.key.toLowerCase());
  const ours = (letter && (event.ctrlKey || event.metaKey) && !event.altKey) || event.key === "F1";
  const here = document.activeElement?.closest("#rendercanvas-focus-element-container");
  if (here && ours) event.preventDefault();
}}, {{ capture: true }});
"""
"""A script that keeps the window's keys from a browser, and from JupyterLab."""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<link rel="stylesheet" href="renderview.css">
<style>
html, body {{ margin: 0; height: 100%; overflow: hidden; background: #1f1f21 }}
div#canvas {{ border: 0; display: block }}
#status {{ display: none; position: fixed; top: 0; left: 0; padding: .5rem 1rem; background: #ddd; color: #222 }}
#status:has(button) {{ display: block }}
#taken {{ display: none; position: fixed; inset: 0; background: #1f1f21cc; place-content: center; text-align: center }}
.taken #taken {{ display: grid }}
.taken #status {{ display: none }}
p {{ color: #aaa; font: 16px system-ui, sans-serif; margin: 2rem }}
#taken p {{ color: #eee }}
#taken button {{ font: 16px system-ui, sans-serif; padding: .5rem 1rem; justify-self: center }}
</style>
<script>
{keys}
// The wheel with Ctrl zooms the picture, wherever the focus is, and not the page.
window.addEventListener("wheel", (event) => {{
  if (event.ctrlKey) event.preventDefault();
}}, {{ capture: true, passive: false }});
// A pen's pressure, which the events that are sent do not have; and the greatest of its drag: not all moves are sent.
let pen = null;
for (const kind of ["pointerdown", "pointermove"]) {{
  const noted = ({{ pointerType, pressure }}) => {{
    const before = kind === "pointermove" && pen !== null ? pen.peak : 0;
    pen = pointerType === "pen" ? {{ pressure, peak: Math.max(before, pressure) }} : null;
  }};
  window.addEventListener(kind, noted, {{ capture: true }});
}}
// Of several pages, the last has the window.
window.WebSocket = class extends WebSocket {{
  send(data) {{
    const event = pen === null || typeof data !== "string" ? {{}} : JSON.parse(data);
    super.send(/^pointer_(down|move|up)$/.test(event.type) ? JSON.stringify({{ ...event, ...pen }}) : data);
  }}
  constructor(...given) {{
    super(...given);
    this.addEventListener("close", (event) => {{
      if (event.code === {taken}) document.body.classList.add("taken");
    }});
  }}
}};
</script>
<script type="module" src="renderview.js"></script>
<script type="module" src="renderview-client.js"></script>
<script type="module">
// Keys are for the picture from the start, and not only once it was clicked on.
new MutationObserver((changes, watch) => {{
  const keys = document.querySelector("#rendercanvas-focus-element-container input");
  if (keys) {{
    watch.disconnect();
    keys.focus({{ preventScroll: true }});
  }}
}}).observe(document.documentElement, {{ childList: true, subtree: true }});
</script>
</head>
<body>
<div id="canvas" class="renderview-wrapper" style="width: 100vw; height: 100vh"><p>Loading {title} …</p></div>
<div id="status"></div>
<div id="taken"><p>Another page has taken this window over.</p>
<button onclick="location.reload()">Take it back</button></div>
</body>
</html>
"""


def page_of(title: str) -> bytes:
    """Return the page of a window."""
    return _PAGE.format(title=escape(title), keys=KEYS, taken=TAKEN).encode()
