"""Answer only browsers of this machine that know the token; nothing else reaches the pages."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, MutableMapping

    Message = MutableMapping[str, Any]
    Receive = Callable[[], Awaitable[Message]]
    Send = Callable[[Message], Awaitable[None]]
    Application = Callable[[Message, Receive, Send], Awaitable[None]]

HOST = "127.0.0.1"
HEADERS = (
    (b"content-security-policy", b"default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; frame-ancestors 'none'"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)


class Guard:
    """An ASGI application before another: it passes on what comes from this machine's browser and holds the cookie.

    Parameters
    ----------
    application
        What is guarded, HTTP and websockets alike.
    port
        Port of the server.
    token
        Secret of the address; it is exchanged for a cookie with another secret.
    """

    def __init__(self, application: Application, port: int, token: str) -> None:
        self._application, self._token = application, token
        self._secret, self._cookie = secrets.token_urlsafe(32), f"probe-design-{port}"
        self._hosts = {f"{name}:{port}".encode() for name in (HOST, "localhost")}
        self._origins = {b"http://" + host for host in self._hosts}

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Answer 403 without token or cookie and from elsewhere, exchange the token, or pass the request on."""
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return
        headers = [(name.lower(), value) for name, value in scope["headers"]]
        if not self._is_local(headers):
            await _refuse(scope, send, "403: only this machine's own page is served")
        elif scope["type"] == "http" and self._has_token(scope):
            cookie = f"{self._cookie}={self._secret}; HttpOnly; SameSite=Strict; Path=/".encode()
            await _respond(send, 303, "", (b"location", scope["path"].encode()), (b"set-cookie", cookie))
        elif self._has_cookie(headers):
            await self._pass_on(scope, receive, send)
        else:
            await _refuse(scope, send, "403: open the address that probe-design explore printed, with its token")

    async def _pass_on(self, scope: Message, receive: Receive, send: Send) -> None:
        """Let the application respond; a page that is left meanwhile is no fault, whatever the framework raises then."""
        is_left = False

        async def receive_and_note() -> Message:
            """Receive a message, and note whether the browser has left."""
            nonlocal is_left
            message = await receive()
            is_left = is_left or message["type"] == "http.disconnect"
            return message

        try:
            await self._application(scope, receive_and_note, _add_headers(send))
        except Exception:
            if not is_left:
                raise

    def _is_local(self, headers: list[tuple[bytes, bytes]]) -> bool:
        """Return whether Host and, where it is stated, Origin are this server's: neither rebinding nor another site's page."""
        hosts = [value for name, value in headers if name == b"host"]
        origins = [value for name, value in headers if name == b"origin"]
        return len(hosts) == 1 and hosts[0] in self._hosts and all(origin in self._origins for origin in origins)

    def _has_token(self, scope: Message) -> bool:
        """Return whether the address holds the token."""
        tokens = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        return scope["path"] == "/" and len(tokens) == 1 and secrets.compare_digest(tokens[0].encode(), self._token.encode())

    def _has_cookie(self, headers: list[tuple[bytes, bytes]]) -> bool:
        """Return whether the browser has exchanged the token before."""
        for name, value in headers:
            if name == b"cookie":
                for part in value.decode("latin-1").split(";"):
                    key, _, text = part.strip().partition("=")
                    if key == self._cookie and secrets.compare_digest(text.encode(), self._secret.encode()):
                        return True
        return False


async def _refuse(scope: Message, send: Send, text: str) -> None:
    """Answer 403, of a websocket by closing it before it opens."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
    else:
        await _respond(send, 403, text)


async def _respond(send: Send, status: int, text: str, *headers: tuple[bytes, bytes]) -> None:
    """Send a response of one line."""
    content = (b"content-type", b"text/plain; charset=utf-8")
    await send({"type": "http.response.start", "status": status, "headers": [content, *HEADERS, *headers]})
    await send({"type": "http.response.body", "body": text.encode()})


def _add_headers(send: Send) -> Send:
    """Return ``send`` with the headers that keep the page on this machine."""

    async def send_with_headers(message: Message) -> None:
        """Send a message."""
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *HEADERS]
        await send(message)

    return send_with_headers
