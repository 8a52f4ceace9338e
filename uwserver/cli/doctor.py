"""The command `doctor`: what is missing on this machine, and what to do about it."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from itertools import chain

import click

from uwserver.cli.colour import Colour, styled
from uwserver.cli.diagnosis import Finding, Level, examine

_COLOURS: Mapping[Level, Colour] = {"ok": "green", "warning": "yellow", "fault": "red"}
_SIGNS = {"ok": "ok     ", "warning": "warning", "fault": "FAULT  "}


@click.command(short_help="Test this machine, and whether it has what a scenario needs.")
@click.argument("scenario", default="")
@click.option("--warm", is_flag=True, help="Compile the physics now, and remove caches of older versions.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def doctor(scenario: str, warm: bool, as_json: bool) -> None:
    """Test this machine: packages, cache of compiled kernels, port, timer and more.

    With SCENARIO, a shipped scenario or a file, also test whether everything that it needs is installed.

    The exit status is 1 if something prevents a server from running.
    """
    broken = _warm() if warm else []
    findings: list[Finding] = []
    for finding in chain(broken, examine(scenario)):
        findings.append(finding)
        if not as_json:
            click.echo(_line(finding))
    faults = sum(finding.level == "fault" for finding in findings)
    if as_json:
        click.echo(json.dumps({"ok": not faults, "findings": [asdict(finding) for finding in findings]}, indent=2))
    else:
        command = f"uwserver run {scenario}".rstrip()
        click.echo(f"{faults} to repair before `{command}` works" if faults else f"ready: {command}")
    sys.exit(1 if faults else 0)


def _line(finding: Finding) -> str:
    line = f"{styled(_SIGNS[finding.level], fg=_COLOURS[finding.level])}  {finding.name:24}  {finding.text}"
    return f"{line}\n{'':35}-> {finding.remedy}" if finding.remedy else line


def _warm() -> list[Finding]:
    """Compile what the cache lacks, with progress on standard error. Return a finding only if that fails."""
    try:
        from uwserver.physics.kernel.compiled import cache_state
        from uwserver.world.warm import prune, warm

        warm(lambda line: click.echo(line, err=True))
    except (ImportError, OSError, RuntimeError) as error:
        return [Finding("warming", "fault", str(error), "pip install --force-reinstall uwserver")]
    if cache_state.folder is not None and not cache_state.reason:
        for old in prune(cache_state.folder):
            click.echo(f"kernels: removed {old}", err=True)
    return []
