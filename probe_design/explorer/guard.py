"""Answer only browsers of this machine that know the token; nothing else reaches the pages."""

from __future__ import annotations

import secrets

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

HEADERS = {
    "content-security-policy": "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; frame-ancestors 'none'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}
REFUSED_WEBSOCKET_CODE = 1008  # policy violation, RFC 6455


class Guard:
    """An ASGI application before another: it passes on what comes from this machine's browser and holds the cookie.

    Parameters
    ----------
    application
        What is guarded, HTTP and websockets alike.
    address
        Host and port of the server.
    token
        Secret of the address; it is exchanged for a cookie with another secret.
    """

    def __init__(self, application: ASGIApp, address: tuple[str, int], token: str) -> None:
        self._application, self._token, (own_host, port) = application, token, address
        self._secret, self._cookie = secrets.token_urlsafe(32), f"probe-design-{port}"
        self._hosts = {f"{name}:{port}" for name in (own_host, "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 403 without token or cookie and from elsewhere, exchange the token, or pass the request on."""
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return
        send, request = _add_headers(send), HTTPConnection(scope)
        if not self._is_local(request):
            await _refuse(scope, receive, send, "403: only this machine's own page is served")
        elif scope["type"] == "http" and self._has_token(request):
            cookie = {"set-cookie": f"{self._cookie}={self._secret}; HttpOnly; SameSite=Strict; Path=/"}
            await RedirectResponse(scope["path"], 303, cookie)(scope, receive, send)
        elif _is_same(request.cookies.get(self._cookie, ""), self._secret):
            await self._pass_on(scope, receive, send)
        else:
            await _refuse(scope, receive, send, "403: open the address that probe-design explore printed, with its token")

    async def _pass_on(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the application respond; a page that is left meanwhile is no fault, whatever the framework raises then."""
        is_left = False

        async def receive_and_note() -> Message:
            """Receive a message, and note whether the browser has left."""
            nonlocal is_left
            message = await receive()
            is_left = is_left or message["type"] == "http.disconnect"
            return message

        try:
            await self._application(scope, receive_and_note, send)
        except Exception:
            if not is_left:
                raise

    def _is_local(self, request: HTTPConnection) -> bool:
        """Return whether Host and, where it is stated, Origin are this server's: neither rebinding nor another site's page."""
        hosts, origins = request.headers.getlist("host"), request.headers.getlist("origin")
        return len(hosts) == 1 and hosts[0] in self._hosts and {*origins} <= {f"http://{host}" for host in self._hosts}

    def _has_token(self, request: HTTPConnection) -> bool:
        """Return whether the address holds the token."""
        tokens = request.query_params.getlist("token")
        return request.scope["path"] == "/" and len(tokens) == 1 and _is_same(tokens[0], self._token)


def _is_same(text: str, secret: str) -> bool:
    """Return whether a text is a secret; the time that it takes says nothing about the secret."""
    return secrets.compare_digest(text.encode(), secret.encode())


async def _refuse(scope: Scope, receive: Receive, send: Send, text: str) -> None:
    """Answer 403, of a websocket by closing it before it opens."""
    is_socket = scope["type"] == "websocket"
    await (WebSocketClose(REFUSED_WEBSOCKET_CODE) if is_socket else PlainTextResponse(text, 403))(scope, receive, send)


def _add_headers(send: Send) -> Send:
    """Return ``send`` with the headers that keep the page on this machine."""

    async def send_with_headers(message: Message) -> None:
        """Send a message."""
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(HEADERS)
        await send(message)

    return send_with_headers
