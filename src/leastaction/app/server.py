"""The server: this computer only, nothing from other hosts, uploads of limited size."""

from __future__ import annotations

import logging
import socket
from typing import Any

from nicegui import app, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware

from leastaction.app.page import close_sessions, root
from leastaction.app.session import MOST_BYTES
from leastaction.errors import InputError

__all__ = ["HOST", "free_port", "serve"]

HOST = "127.0.0.1"
_PORTS = range(8137, 8157)
# Vue compiles templates in the browser, hence 'unsafe-eval'; every source is this server.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws://{host}; object-src 'none'; "
    "base-uri 'self'; form-action 'self'; frame-ancestors 'none'"
)
_FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><path d="M4 5Q9 29 28 27" fill="none" '
    'stroke="#0b67ad" stroke-width="4" stroke-linecap="round"/>'
    '<circle cx="14" cy="20" r="4.5" fill="#d0580a"/></svg>'
)


def free_port(port: int | None) -> int:
    """Return `port` if it is free; without one, the first free of a few.

    Raises
    ------
    InputError
        If there is none.
    """
    for candidate in _PORTS if port is None else [port]:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, candidate))
            except OSError:
                continue
            return candidate
    what = f"port {port} is" if port is not None else f"ports {_PORTS[0]} to {_PORTS[-1]} are"
    raise InputError(f"{what} in use, perhaps by another app that still runs; give another one with --port")


class Guard:
    """Refuses bodies that are too large, and tells the browser to load nothing from elsewhere.

    The Host header is checked too (see `install`): a foreign page whose name is made to point at this
    computer gets no answer.
    """

    def __init__(self, application: Any) -> None:
        self.application = application

    async def __call__(self, scope, receive, send) -> None:
        if scope["type"] != "http":
            await self.application(scope, receive, send)
            return
        headers = dict(scope["headers"])
        policy = _POLICY.format(host=headers.get(b"host", b"127.0.0.1").decode("latin-1")).encode("latin-1")
        taken = 0

        async def limited() -> Any:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            # As if the browser had gone: whoever reads the body gives up.
            return {"type": "http.disconnect"} if taken > MOST_BYTES + 1_000_000 else message

        async def guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                extra = [(b"content-security-policy", policy), (b"x-content-type-options", b"nosniff")]
                message["headers"] = [
                    *message.get("headers", []),
                    *extra,
                    (b"referrer-policy", b"no-referrer"),
                ]
            await send(message)

        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > MOST_BYTES + 1_000_000:
            await guarded({"type": "http.response.start", "status": 413, "headers": []})
            await send({"type": "http.response.body", "body": b"the file is too large"})
            return
        await self.application(scope, limited, guarded)


def _worth_telling(record: logging.LogRecord) -> bool:
    """Whether a record of the web server is more than a browser that left before its answer."""
    error = record.exc_info[1] if record.exc_info else None
    return not (isinstance(error, RuntimeError) and str(error) == "No response returned.")


def install() -> None:
    """Put the guards before NiceGUI, and end all work with it."""
    logging.getLogger("uvicorn.error").addFilter(_worth_telling)
    app.add_middleware(Guard)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    app.on_shutdown(close_sessions)


def serve(port: int, show: bool) -> None:
    """Run until interrupted."""
    install()
    ui.run(
        root,
        host=HOST,
        port=port,
        show=show,
        title="leastaction",
        favicon=_FAVICON,
        dark=None,
        language="en-US",
        reload=False,
        tailwind=False,
        show_welcome_message=False,
        reconnect_timeout=30.0,
    )
