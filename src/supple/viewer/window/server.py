"""The window in a browser of another machine: bound to localhost, and protected by a token."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import signal
import socket
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qs, urlsplit

from supple.errors import SuppleError
from supple.viewer.window.page import TAKEN, page_of

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
    page, turns = page_of(title), _Turns(app)

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
    """Connections of pages, of which one at a time is served: each takes over from the one before."""

    def __init__(self, app: App) -> None:
        self._app = app
        self._last = asyncio.Event(), asyncio.Event()  # of the last page: it is taken over; it has left
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
    """Return the values of a cookie, among those of other programs on this host."""
    parts = (part.strip().partition(b"=") for line in _headers(scope, b"cookie") for part in line.split(b";"))
    return [value for key, _, value in parts if key == name]


def _from_here(scope: Scope) -> bool:
    """Return whether a request is from our own page: cookies are sent by pages of any port of a host."""
    hosts = [host.decode("latin-1").lower() for host in _headers(scope, b"host")]
    try:
        return all(urlsplit(o.decode("latin-1")).netloc.lower() in hosts for o in _headers(scope, b"origin"))
    except ValueError:
        return False


async def _answer(send: Send, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def listening(port: int) -> socket.socket:
    """Return a socket on this machine; port 0 for any free one.

    Raises
    ------
    SuppleError
        If the port is taken.
    """
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
    except OSError as error:
        made.close()
        raise SuppleError(f"port {port} cannot be used ({error.strerror}): choose another one, or 0 for any") from None
    return made


def serve(app: App, listener: socket.socket, over: Callable[[], bool] = lambda: False) -> None:
    """Serve until an interrupt, or the end of all windows.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl+C.
    """
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
