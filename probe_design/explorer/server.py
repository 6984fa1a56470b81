"""Serve the pages on the loopback only, from an address that is announced before the pages are built, which takes a second."""

from __future__ import annotations

import logging
import secrets
import signal
import socket
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from geometry.common.errors import InputError

if TYPE_CHECKING:
    from fastapi import FastAPI

HOST = "127.0.0.1"
MAX_LINE_LENGTH = 200  # characters of a fault on standard error
SHUTDOWN_S = 1  # s that open pages have to end


class OneLine(logging.Formatter):
    """Write a fault in one line, as the pages' messages may be malformed by anything: no traceback is of use to the user."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        fault = record.exc_info[1] if record.exc_info else None
        what = record.getMessage() if fault is None else f"a message of a page is left out ({type(fault).__name__}: {fault})"
        return f"probe-design: {' '.join(what.split())[:MAX_LINE_LENGTH]}"


@contextmanager
def announce(port: int, open_browser: bool) -> Iterator[tuple[socket.socket, str]]:
    """Print the address with its token; yield the socket, at which browsers wait from now on, and the token.

    Parameters
    ----------
    port
        Of the loopback; 0 for any that is free.
    open_browser
        Whether to open the page in the browser.

    Raises
    ------
    InputError
        The port is taken, or not permitted.
    """
    try:
        listener = socket.create_server((HOST, port))
    except OSError as fault:
        raise InputError("port", port, f"a free port of {HOST}, or 0 for any ({fault.strerror})") from None
    with listener:
        token = secrets.token_urlsafe(24)
        address = f"http://{HOST}:{listener.getsockname()[1]}/?token={token}"
        print(address, flush=True)
        if open_browser:
            webbrowser.open(address)
        yield listener, token


def serve(application: FastAPI, listener: socket.socket, token: str) -> None:
    """Serve an application until Ctrl-C.

    Parameters
    ----------
    application
        What is served.
    listener, token
        Of ``announce``.
    """
    import uvicorn

    from probe_design.explorer.guard import Guard

    class Server(uvicorn.Server):
        """A server that ends with Ctrl-C as any program that is done: without raising the signal again."""

        @contextmanager
        def capture_signals(self) -> Iterator[None]:
            """Handle the signals that end the server while it runs."""
            numbers = [signal.SIGINT, signal.SIGTERM]
            handlers = [signal.signal(number, self.handle_exit) for number in numbers]
            try:
                yield
            finally:
                for number, handler in zip(numbers, handlers, strict=True):
                    signal.signal(number, handler)

    guarded = Guard(application, listener.getsockname(), token)
    config = uvicorn.Config(
        guarded,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        ws="websockets-sansio",
    )
    handler = logging.StreamHandler()
    handler.setFormatter(OneLine())
    logging.getLogger().addHandler(handler)
    Server(config).run(sockets=[listener])
