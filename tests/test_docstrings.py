"""Exports and entry points of the rooms are documented in full; the rest in a sentence."""

import importlib
import inspect
import pkgutil
import re

import docstring_parser
import pytest

import airpuck


def modules():
    for info in pkgutil.walk_packages(airpuck.__path__, "airpuck."):
        if not info.name.startswith("airpuck.cli"):  # its help texts are the documentation
            yield importlib.import_module(info.name)


def public_functions(module):
    """Functions and methods that a module defines, by the name of what holds them."""
    for name, thing in vars(module).items():
        if name.startswith("_") or getattr(thing, "__module__", None) != module.__name__:
            continue
        if inspect.isfunction(thing):
            yield name, name, thing
        elif inspect.isclass(thing):
            for method_name, method in vars(thing).items():
                function = getattr(method, "__func__", method)
                if not method_name.startswith("_") and inspect.isfunction(function):
                    yield name, f"{name}.{method_name}", function


def entry_points():
    """`module.name` of each entry point that a room's docstring lists."""
    for info in pkgutil.iter_modules(airpuck.__path__, "airpuck."):
        text = importlib.import_module(info.name).__doc__ or ""
        for name in re.findall(r"`(\w+\.\w+)`", text.partition("Entry points:")[2]):
            yield f"{info.name}.{name}"


EXPORTED = {f"{home}.{name}" for name, home in airpuck._HOME.items()}
ENTRIES = set(entry_points())
FUNCTIONS = {
    f"{module.__name__}.{name}": (f"{module.__name__}.{holder}" in EXPORTED | ENTRIES, function)
    for module in modules()
    for holder, name, function in public_functions(module)
}


@pytest.mark.parametrize("name", sorted(ENTRIES))
def test_entry_points_exist(name):
    module, _, attribute = name.rpartition(".")
    assert hasattr(importlib.import_module(module), attribute)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_documented_is_what_is_there(name):
    full, function = FUNCTIONS[name]
    text = inspect.getdoc(inspect.unwrap(function))
    assert text, "no docstring"
    if "see `" in text.splitlines()[0]:
        return  # documented where the interface is defined
    documentation = docstring_parser.parse(text, docstring_parser.DocstringStyle.NUMPYDOC)
    documented = {
        part.strip().lstrip("*") for p in documentation.params for part in p.arg_name.split(",")
    }
    signature = inspect.signature(inspect.unwrap(function))
    if full:
        assert documented == set(signature.parameters) - {"self", "cls"}
        if signature.return_annotation not in (inspect.Signature.empty, None, "None"):
            assert documentation.returns or documentation.many_returns or "Yields" in text
    else:
        assert documented <= set(signature.parameters)
