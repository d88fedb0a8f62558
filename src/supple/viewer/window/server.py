"""The window in a browser of another machine: bound to localhost, and protected by a token."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import signal
import socket
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from html import escape
from typing import Any
from urllib.parse import parse_qs, urlsplit

from supple.errors import SuppleError
from supple.viewer.tools.gestures import COMMANDS

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HOST = "127.0.0.1"
PATIENCE = 3  # seconds for browsers to disconnect
_REFUSED = b"This window is open to those who have its whole address, with the token that supple view printed.\n"


def guarded(app: App, token: str, title: str) -> App:
    """Return an ASGI application, `rendercanvas.http.asgi`, that requires a token; the title is that of its page.

    The token comes once in the address, and then as a cookie. Of several pages, the last one has the window.
    """
    name = "supple-" + token[:6]
    page, turns = _PAGE.format(title=escape(title), keys=KEYS, taken=TAKEN).encode(), _Turns(app)

    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await app(scope, receive, send)
            return
        brought = any(hmac.compare_digest(value, token.encode()) for value in _cookies(scope, name.encode()))
        if brought and (scope["type"] != "websocket" or _from_here(scope)):
            if scope["type"] == "http" and scope["path"] in ("/", "/index.html"):
                await _answer(send, 200, page, [(b"content-type", b"text/html; charset=utf-8"), *_PRIVATE])
            elif scope["type"] == "websocket":
                await turns.serve(scope, receive, send)
            else:
                await app(scope, receive, send)
            return
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403})
            return
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if hmac.compare_digest(given.encode(), token.encode()):
            # Redirect without the token, which keeps it out of histories and referrers.
            cookie = f"{name}={token}; HttpOnly; SameSite=Strict; Path=/"
            await _answer(send, 303, b"", [(b"location", b"/"), (b"set-cookie", cookie.encode()), *_PRIVATE])
        else:
            await _answer(send, 403, _REFUSED, [(b"content-type", b"text/plain"), *_PRIVATE])

    return serve


class _Turns:
    """The connections of pages, which are served one at a time: each takes over from the one before."""

    def __init__(self, app: App) -> None:
        self._app = app
        self._last = asyncio.Event(), asyncio.Event()  # of the last page: set when it is taken over; when it has left
        self._last[1].set()

    async def serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a page until it leaves, or another one takes over."""
        taken, left = mine = asyncio.Event(), asyncio.Event()
        (end, ended), self._last = self._last, mine

        async def hear() -> MutableMapping[str, Any]:
            heard, over = asyncio.ensure_future(receive()), asyncio.ensure_future(taken.wait())
            try:
                await asyncio.wait((heard, over), return_when=asyncio.FIRST_COMPLETED)
                return {"type": "websocket.disconnect", "code": TAKEN} if taken.is_set() else heard.result()
            finally:
                heard.cancel()
                over.cancel()

        try:
            end.set()
            await ended.wait()
            await self._app(scope, hear, send)
        finally:
            left.set()
        if taken.is_set():
            with contextlib.suppress(Exception):  # it may have left by itself
                await send({"type": "websocket.close", "code": TAKEN})


_PRIVATE = [(b"cache-control", b"no-store"), (b"referrer-policy", b"no-referrer"), (b"x-frame-options", b"DENY")]


def _headers(scope: Scope, name: bytes) -> list[bytes]:
    return [value for key, value in scope.get("headers", []) if key == name]


def _cookies(scope: Scope, name: bytes) -> list[bytes]:
    """Return all values of a cookie: other programs on this host may set cookies, too."""
    parts = (part.strip().partition(b"=") for line in _headers(scope, b"cookie") for part in line.split(b";"))
    return [value for key, _, value in parts if key == name]


def _from_here(scope: Scope) -> bool:
    """Return whether a request is from our own page: browsers send cookies for pages of any port of a host."""
    hosts = [host.decode("latin-1").lower() for host in _headers(scope, b"host")]
    try:
        return all(urlsplit(o.decode("latin-1")).netloc.lower() in hosts for o in _headers(scope, b"origin"))
    except ValueError:
        return False


async def _answer(send: Send, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def listening(port: int) -> socket.socket:
    """Return a socket on this machine; port 0 for any free one; SuppleError if the port is taken."""
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
    except OSError as error:
        made.close()
        raise SuppleError(f"port {port} cannot be used ({error.strerror}): choose another one, or 0 for any") from None
    return made


def serve(app: App, listener: socket.socket, over: Callable[[], bool] = lambda: False) -> None:
    """Serve until an interrupt, which raises KeyboardInterrupt, or until ``over`` returns True."""
    import uvicorn

    class Server(uvicorn.Server):
        async def on_tick(self, counter: int) -> bool:
            if main:  # a canvas's loop handles Ctrl+C itself, and would end alone
                signal.signal(signal.SIGINT, self.handle_exit)
            return await super().on_tick(counter) or over()

    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    config = uvicorn.Config(
        app, log_level="warning", ws="websockets-sansio", lifespan="on", timeout_graceful_shutdown=PATIENCE
    )
    try:
        Server(config).run(sockets=[listener])
    finally:
        if main:
            signal.signal(signal.SIGINT, before)


TAKEN = 4001
"""The code that closes the connection of a page when another page takes over its window."""

# The focus of a canvas is on an element of its own: then browsers do nothing for the window's other keys.
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
