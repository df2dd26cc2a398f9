"""The web server of the page: static files, one websocket a player, and who may use them.

A server on one's own machine can be reached by every page that the same browser shows. So requests are answered
only under the server's own names (a foreign name that leads here is an attack known as DNS rebinding), websockets
only from its own pages, and the page may load and connect to nothing else.
"""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from analysis.play.conversation import FULL, Conversation
from analysis.play.study import Study

STATIC = Path(__file__).resolve().parent / "static"

MOST_CONNECTIONS = 200
MOST_BYTES = 1024
"""Of one message of the page, before anybody looks at it."""

HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
    "cache-control": "no-cache",
}


def application(study: Study, host: str = "127.0.0.1", site: str | None = None) -> Starlette:
    """Make the web application.

    Parameters
    ----------
    study : Study
        Closed when the application ends.
    host : str
        Address that is listened on: a name for this server besides those of the loopback.
    site : str, optional
        Public address such as ``https://study.example.org``, where another server passes requests on.
    """
    files = ThreadPoolExecutor(1, thread_name_prefix="study")
    pages: dict[int, Conversation] = {}
    open_now: set[Conversation] = set()

    async def play(socket: WebSocket) -> None:
        if len(open_now) >= MOST_CONNECTIONS:
            await socket.close(FULL)
            return
        talk = Conversation(socket, study, files, pages)
        open_now.add(talk)
        try:
            await talk.run()
        finally:
            open_now.discard(talk)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        files.shutdown()
        study.close()

    routes = [WebSocketRoute("/play", play), Mount("/", StaticFiles(directory=STATIC, html=True))]
    app = Starlette(routes=routes, lifespan=lifespan)
    app.add_middleware(OwnPagesOnly, host=host, site=site)
    return app


class OwnPagesOnly:
    """Refuses requests under foreign names and websockets of foreign pages; puts `HEADERS` on every answer."""

    def __init__(self, app: ASGIApp, host: str, site: str | None) -> None:
        self.app, self.site = app, None if site is None else site.rstrip("/").lower()
        self.names = {"localhost", host.lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        allowed = self._own_name(headers.get("host", ""))
        if scope["type"] == "websocket":
            if not allowed or not self._own_page(headers):
                await WebSocket(scope, receive, send).close(1008)
                return
            await self.app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        if not allowed:
            await PlainTextResponse("this server has another name", 421)(scope, receive, with_headers)
            return
        await self.app(scope, receive, with_headers)

    def _own_name(self, host: str) -> bool:
        """Whether a request asks for this server: by a name of its own, or by number, which nobody can rebind."""
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        if not name:
            return False
        if name in self.names or (self.site is not None and name == urlsplit(self.site).hostname):
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    def _own_page(self, headers: Headers) -> bool:
        """Whether the page that connects came from here; browsers do not let pages lie about it."""
        origins = headers.getlist("origin")
        if len(origins) != 1:
            return False
        origin = origins[0].lower()
        return origin in (f"http://{headers.get('host', '').lower()}", self.site)
