"""The program: its commands, and what becomes of errors."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

import click

from leastaction.cli import app, demonstrate, discover, generate, use
from leastaction.cli.failures import Interrupted, give_up

__all__ = ["main", "program"]


class _Program(click.Group):
    """A group whose errors become one line on stderr and an exit code (see `failures`)."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.obj = list(args)  # for the report, which shows the command
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with warnings.catch_warnings():
                # What a user can act on is in the model's own warnings.
                if not sys.warnoptions:
                    warnings.simplefilter("ignore")
                return super().invoke(ctx)
        except KeyboardInterrupt:
            # click would add an empty line.
            raise Interrupted from None
        except BrokenPipeError:
            # Whoever read the output has gone; click would call that an error of exit code 1.
            raise Interrupted(141) from None

    def main(self, args=None, prog_name=None, complete_var=None, standalone_mode=True, **extra: Any) -> Any:
        try:
            code = super().main(
                args, prog_name or "leastaction", complete_var, standalone_mode=False, **extra
            )
        except Exception as error:
            code = give_up(error)
        sys.exit(code)


@click.group(
    name="leastaction",
    cls=_Program,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="\b\nExample:\n  leastaction generate cart_spring_pendulum --noise 0.02 -o cart.csv",
)
@click.version_option(package_name="leastaction", message="%(prog)s %(version)s")
@click.pass_context
def program(ctx: click.Context) -> None:
    """Find the Lagrangian of a mechanical system from noisy measured coordinates.

    Exit code 0: done; 1: the data do not support any model; 2: wrong use or bad input.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


for _command in (
    discover.discover,
    use.show,
    use.simulate,
    use.validate,
    use.export,
    generate.generate,
    demonstrate.demo,
    app.app,
):
    program.add_command(_command)


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the program with `args` (default: those of the process) and exit."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe that has no θ must not end the program.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    program.main(args)
    raise AssertionError("program.main exits")
