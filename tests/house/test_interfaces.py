"""The Python interfaces explain themselves: all that the reference shows has a docstring, type hints, and the parameters it names."""

from __future__ import annotations

import importlib
import inspect
import sys
from functools import cached_property
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from api_pages import PAGES, Docstring, is_called, public_members

THINGS = {
    f"{subject.module}.{name}": (subject.module, name)
    for page in PAGES.values()
    for subject in page.subjects
    for name in subject.names
}


def functions(thing, name):
    """Yield (name, function, docstring) of a function, or of all public members of a class and of how objects of it are made."""
    if not inspect.isclass(thing):
        yield name, thing, thing.__doc__
        return
    if is_called(thing):
        yield f"{name}.__init__", thing.__init__, thing.__init__.__doc__
    for key, value in public_members(thing):
        if isinstance(value, property):
            function = value.fget
        elif isinstance(value, cached_property):
            function = value.func
        else:
            function = getattr(value, "__func__", value)
        yield f"{name}.{key}", function, function.__doc__


@pytest.mark.parametrize("path", THINGS)
def test_it_is_documented_and_typed(path):
    module, name = THINGS[path]
    thing = getattr(importlib.import_module(module), name)
    assert thing.__doc__, f"{path} has no docstring"
    wrong = []
    for member, function, doc in functions(thing, name):
        if not doc:
            wrong.append(f"{member} has no docstring")
        parameters = inspect.signature(function).parameters.values()
        untyped = [p.name for p in parameters if p.annotation is p.empty and p.name not in ("self", "cls")]
        if inspect.signature(function).return_annotation is inspect.Signature.empty:
            untyped.append("what it returns")
        if untyped:
            wrong.append(f"{member}: no type of {', '.join(untyped)}")
        told = {word.lstrip("*") for word in Docstring(inspect.cleandoc(doc or "")).names("Args")}
        if strange := told - {p.name for p in parameters}:
            wrong.append(f"{member}: the docstring explains {', '.join(strange)}, which is no parameter")
    assert not wrong


@pytest.mark.parametrize("module", ["uwserver", "uwclient", "uwserver.adapter", "uwserver.ports", "uwserver.testing"])
def test_the_reference_has_each_class_and_function_that_a_module_exports(module):
    shown, home = {name for of, name in THINGS.values() if of == module}, importlib.import_module(module)
    exported = {name: getattr(home, name) for name in home.__all__}
    everything = {name for name, thing in exported.items() if inspect.isclass(thing) or inspect.isroutine(thing)}
    assert everything - shown <= {"Scenario"}, "Scenario has a page of its own, as the reference of files"
