"""``leastaction app``: the local app in the browser."""

from __future__ import annotations

import click

from leastaction.cli.show import say

__all__ = ["app"]


@click.command(
    short_help="Open the local app in the browser.",
    epilog="""\b
Example:
  leastaction app --port 8200 --no-browser
""",
)
@click.option(
    "--port",
    type=click.IntRange(1024, 65535),
    metavar="PORT",
    help="Port on this computer. Default: the first free one from 8137.",
)
@click.option("--no-browser", is_flag=True, help="Print the address without opening the browser.")
def app(port: int | None, no_browser: bool) -> None:
    """Open the local app: from a table to a model in the browser.

    The app is reachable only from this computer, by a browser that has opened the printed address with its
    token, and loads nothing from elsewhere. End it with Ctrl-C. It needs pip install 'leastaction[app]'.
    """
    from leastaction.app import run

    try:
        run(port, not no_browser, lambda address: say(f"leastaction app: {address} (end it with Ctrl-C)"))
    except KeyboardInterrupt:
        say("ended")  # the usual way to end it
