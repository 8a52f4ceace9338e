"""There is one order of a tick: each thing that moves, touches, measures or delivers is called from one function, and ticks are made by the step."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

from sources import Function, Module, module_of, modules

BY_ADDRESS = {"call", "call_for_number", "call_for_float", "call_for_struck"}
"""What calls compiled code by where it lies (`physics.kernel.calling`)."""

STAGES = {
    "step_pilots": "uwserver.step.tick._waits_for_python",
    "find_pairs": "uwserver.step.bodies.find_contacts",
    "find_lines": "uwserver.step.bodies.find_contacts",
    "find_contacts": "uwserver.step.bodies.find_contacts",
    "fill_flows": "uwserver.step.bodies.fill_flows",
    "strike": "uwserver.physics.contact.carrying._touch",
    "advance": "uwserver.physics.contact.carrying._advance",
    "finish_contacts": "uwserver.physics.contact.carrying._touch",
    "rates": "uwserver.physics.contact.carrying.find_rates",
    "cast": "uwserver.step.readings._aim",
    "aim": "uwserver.step.readings._aim",
    "code": "uwserver.step.readings._read",
    "tell": "uwserver.step.readings._write_one",
    "deliver": "uwserver.step.readings._round",
    "listen": "uwserver.step.tick._go_on",
}
"""What a tick consists of, by the field in which its code stands, and who calls it: autopilots, contacts, water, bodies, readings, delivery."""

KERNELS = {
    "uwserver.physics.dynamics.integrator": ("advance", "advance_fitted", "rates_of_change", "rates_of_change_fitted"),
    "uwserver.physics.contact.step": ("strike", "strike_fitted", "finish_contacts"),
    "uwserver.physics.contact.carrying": ("carry", "find_rates"),
    "uwserver.physics.rays.meeting": ("meet",),
    "uwserver.step.delivery": ("deliver",),
    "uwserver.step.tick": ("step",),
    "uwserver.step.many": ("step_each",),
}
"""The code itself: nobody calls it by its name, but who is named here."""
BY_NAME = {
    "uwserver.step.bodies.move": "carry",
    "uwserver.step.bodies.find_rates": "find_rates",
    "uwserver.physics.contact.carrying.carry_alone": "carry",
    "uwserver.physics.contact.carrying.find_rates_alone": "find_rates",
    "uwserver.physics.warm.solid_kernels": "meet",  # once, to see that it works
}


def functions(module: Module, *suspect: str) -> Iterator[tuple[str, ast.AST]]:
    for node in module.nodes(*suspect):
        if isinstance(node, Function):
            yield f"{module.name}.{node.name}", node


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _imports(module: Module, target: str) -> bool:
    return any(target in (i.target, f"{i.target}.{i.name}") for i in module.imports)


def _is_by_address(call: ast.Call) -> bool:
    return isinstance(call.func, ast.Name) and call.func.id in BY_ADDRESS and len(call.args) == 2


def by_address(each: Iterable[Module]) -> Iterator[tuple[str, str]]:
    """What is called by where it lies, and in which function."""
    for module in each:
        for where, function in functions(module, *(rf"\b{name}\(" for name in BY_ADDRESS)):
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and _is_by_address(node):
                    yield _name(node.args[0]), where


def by_name(each: Iterable[Module]) -> Iterator[tuple[str, str]]:
    """Kernels of a tick that are called by their names, in a module that imports them or is theirs, and in which function."""
    for module in each:
        known = {
            name
            for target, names in KERNELS.items()
            for name in names
            if module.name == target or _imports(module, target)
        }
        for where, function in functions(module, *(rf"\b{name}\(" for name in known)) if known else ():
            for node in ast.walk(function):
                if not isinstance(node, ast.Call) or _name(node.func) not in known:
                    continue
                of = node.func.value if isinstance(node.func, ast.Attribute) else None
                if of is None or (isinstance(of, ast.Name) and of.id not in ("self", "cls")):
                    yield _name(node.func), where


def test_a_stage_is_called_from_one_function() -> None:
    found: dict[str, set[str]] = {}
    for what, where in by_address(modules("uwserver")):
        found.setdefault(what, set()).add(where)
    worlds = found["code"] - {STAGES["code"]}
    assert worlds == {"uwserver.step.many.step_each"}  # which calls the step itself, of each world
    assert found | {"code": {STAGES["code"]}} == {what: {where} for what, where in STAGES.items()}


def test_what_a_tick_consists_of_is_not_called_past_it() -> None:
    found = {where: what for what, where in by_name(modules("uwserver"))}
    assert found == BY_NAME


def test_a_call_past_it_is_found() -> None:
    text = "from uwserver.physics.dynamics import integrator\ndef more(world):\n    for k in range(9):\n        integrator.advance(world, 0.0, 0.1)\n"
    assert list(by_name([module_of("uwserver.copies.loops", text)])) == [("advance", "uwserver.copies.loops.more")]
    text = "from uwserver.physics.kernel.calling import call\ndef more(codes):\n    call(codes.finish_contacts, ())\n"
    assert list(by_address([module_of("uwserver.copies.loops", text)])) == [
        ("finish_contacts", "uwserver.copies.loops.more")
    ]


def test_ticks_are_made_by_the_step_alone() -> None:
    """One world in one place, many in another; who calls these loops over reasons to stop, not over ticks."""
    importers = {
        what: {module.name for module in modules("uwserver") if _imports(module, f"uwserver.step.{what}")}
        for what in ("tick", "many")
    }
    loading = {"uwserver.world.stepping.kernel_stages"}
    assert importers["tick"] - loading == {"uwserver.world.stepping.stepping", "uwserver.step.many"}
    assert importers["many"] - loading == {"uwserver.copies.steps", "uwserver.copies.commands"}
    loops = [
        module.at(node.lineno, "a loop over ticks")
        for module in modules("uwserver")
        if not module.name.startswith(("uwserver.step.", "uwserver.validation."))  # there bodies alone make trials
        for node in module.nodes(r"range\(\w*ticks\)", r"\badvance\(")
        if isinstance(node, ast.For | ast.While) and _is_over_ticks(node)
    ]
    assert loops == []


def _is_over_ticks(loop: ast.For | ast.While) -> bool:
    """Whether a loop carries bodies on by a tick each time."""
    return any(
        isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "advance"
        and _name(node.func.value) in ("hydro", "_hydro", "bodies")
        for node in ast.walk(loop)
    )  # fmt: skip


def test_a_loop_over_ticks_is_found() -> None:
    loop = ast.parse("for k in range(ticks):\n    self.hydro.advance(k * dt)").body[0]
    assert isinstance(loop, ast.For)
    assert _is_over_ticks(loop)
