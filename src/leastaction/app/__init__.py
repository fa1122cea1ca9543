"""The local app: one page on 127.0.0.1 with the functions of the command line: data, candidates, result.

NiceGUI, on which it is built, is an extra and is imported only when the app starts.

* ``server.py``: start, port, token and cookie; guards: origins, host names, size of uploads, a policy that
  lets the browser load from this server only.
* ``page.py``: header with steps and the button to save; one session per browser tab, which outlives a reload.
* ``data_view.py``, ``candidates_view.py``, ``running_view.py``, ``result_view.py``, ``verdict_view.py``,
  ``walk_view.py``, ``parts.py``: the three steps, the trade-off curve, small pieces.
* ``arm_view.py``: robot arms, from a log and a URDF to animation and report.
* ``stick.js``, ``style.css``: moving links and arms; colours and type, the same as in the report.
* ``session.py``: data, choices and results of a tab.
* ``columns.py``: roles of the columns, and the call of the reader.
* ``candidates.py``: candidates, friction, known coefficients, assumptions on forces: checked as they are
  typed.
* ``worker.py``, ``jobs.py``, ``arm.py``: the process that computes and can be killed at any moment, and its
  jobs: a discovery, a refit, properties of their laws (symmetries, simple numbers), forecasts, an arm.
* ``files.py``, ``remedies.py``, ``motion.py``, ``figures.py``: uploads and downloads, what a click changes,
  stick figures, plots.

Modules from ``session.py`` on in this list do not depend on NiceGUI and are tested without it. Rules:

* Text from a file or a user is shown by ``say``, which never parses it as HTML. ``drawn`` and ``math`` take
  only markup from ``report``.
* Handlers are wrapped in ``page.guarded``, which shows an error as one line in the page.
  ``LEASTACTION_DEBUG=1`` prints the traceback in the terminal.
* A step along the trade-off curve shows a provisional model (`leastaction.refit.provisional`) at once.
  ``Session`` then starts the refit and the forecasts. No result of another structure is shown meanwhile.
* Work that takes longer than 0.1 s runs in a thread (``run.io_bound``) or, if it must be cancellable, in the
  worker.
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
        Called with the address before the server starts. The address contains a token, which gives access.

    Raises
    ------
    InputError
        If NiceGUI is not installed, or the port is in use.
    """
    try:
        import nicegui  # noqa: F401
    except ImportError:
        raise InputError("the app needs NiceGUI; install it with: pip install 'leastaction[app]'") from None
    from leastaction.app.server import Keys, free_port, serve

    chosen = free_port(port)
    keys = Keys(chosen)
    if announce is not None:
        announce(keys.address)
    serve(chosen, keys, show)
