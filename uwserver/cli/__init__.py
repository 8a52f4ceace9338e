"""The command line. Each group of commands has its module, imported only when it is used."""

from __future__ import annotations

import importlib

import click

from uwserver import __version__
from uwserver.requests import suggestion

_WHERE = {
    "run": "run",
    "check": "scenario",
    "schema": "scenario",
    "list": "scenario",
    "new": "scenario",
    "replay": "replay",
    "plot": "plot",
    "validate": "validate",
    "bench": "bench",
    "doctor": "doctor",
}


class _Lazy(click.Group):
    """Finds a command in its module when it is asked for: `uwserver list` need not load the server."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_WHERE)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _WHERE:
            return None
        module = importlib.import_module(f"uwserver.cli.{_WHERE[cmd_name]}")
        found: click.Command = next(command for command in module.COMMANDS if command.name == cmd_name)
        return found

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in _WHERE:
            ctx.fail(f'no command "{args[0]}"{suggestion(args[0], _WHERE)}; there are: {", ".join(_WHERE)}')
        return super().resolve_command(ctx, args)


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="uwserver")
def main() -> None:
    """Headless co-simulation server for underwater robots."""
