"""The local app: a page in the browser for what the command line does, on this computer only.

NiceGUI, which it is built on, is an extra and is imported when the app starts.
"""

from __future__ import annotations

from collections.abc import Callable

from leastaction.errors import InputError

__all__ = ["run"]


def run(port: int | None = None, show: bool = True, announce: Callable[[str], None] | None = None) -> None:
    """Serve the app on 127.0.0.1 until interrupted.

    Parameters
    ----------
    port : int, optional
        By default the first free one from 8137.
    show : bool
        Open it in the browser.
    announce : callable, optional
        Called with the address before the server starts.

    Raises
    ------
    InputError
        If NiceGUI is not installed, or the port is in use.
    """
    try:
        import nicegui  # noqa: F401
    except ImportError:
        raise InputError("the app needs NiceGUI; install it with: pip install 'leastaction[app]'") from None
    from leastaction.app.server import HOST, free_port, serve

    chosen = free_port(port)
    if announce is not None:
        announce(f"http://{HOST}:{chosen}")
    serve(chosen, show)
