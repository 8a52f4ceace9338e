"""Lists ports and services as text: by vehicle, sensors first, and services of equal components together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from uwclient.ports import Field, Port, Service


def listing(ports: Sequence[Port], services: Sequence[Service], whole: bool = False) -> Iterator[str]:
    """Yield lines for people.

    Args:
        ports: ports of the server.
        services: services of the server.
        whole: whether each service gets a line with its arguments; otherwise those of equal components share a line.
    """
    owners = list(
        dict.fromkeys(path.partition("/")[0] for path in [p.path for p in ports] + [s.path for s in services])
    )
    owners.sort(key=lambda owner: owner == "world")  # vehicles first
    for owner in owners:
        own_ports = [port for port in ports if port.path.startswith(f"{owner}/")]
        own_services = [service for service in services if service.path.startswith(f"{owner}/")]
        yield owner
        for port in sorted(own_ports, key=lambda port: port.direction != "sensor"):
            yield f"  {_port_line(port)}"
        for line in map(_service_line, own_services) if whole else _folded(owner, own_services):
            yield f"  {line}"
    if services and not whole:
        yield "--services shows the arguments of services, --json shows everything."


def _port_line(port: Port) -> str:
    rate_hz = f"{port.rate_hz:g} Hz" if port.rate_hz else "-"
    fields = ", ".join(_field(field) for field in port.fields)
    return f"{port.path:30} {port.direction:9} {rate_hz:8} {fields}"


def _field(field: Field) -> str:
    shape = "x".join("n" if size < 0 else str(size) for size in field.shape)
    shape = " ".join(filter(None, (field.dtype, shape)))
    return field.name + (f"[{shape}]" if shape else "") + (f" {field.unit}" if field.unit not in ("", "1") else "")


def _service_line(service: Service) -> str:
    arguments = ", ".join(entry.name if entry.required else f"[{entry.name}]" for entry in service.arguments)
    return f"{service.path:30} {'service':9} {'-':8} {arguments}".rstrip()


def _folded(owner: str, services: Sequence[Service]) -> Iterator[str]:
    """Yield a line for the services of each component; components with the same services share a line."""
    names: dict[str, list[str]] = {}
    for service in services:
        component, _, name = service.path.removeprefix(f"{owner}/").rpartition("/")
        names.setdefault(component, []).append(name)
    alike: dict[tuple[str, ...], list[str]] = {}
    for component, own in names.items():
        alike.setdefault(tuple(own), []).append(component)
    for own_names, components in alike.items():
        which = ",".join(components)
        place = f"{owner}/{{{which}}}/" if len(components) > 1 else f"{owner}/{which}/".replace("//", "/")
        yield f"{place} services: {', '.join(own_names)}"
