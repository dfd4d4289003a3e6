"""Exports and entry points of packages have full documentation; the rest has a sentence."""

import importlib
import inspect
import pkgutil
import re

import docstring_parser

import airpuck
import airpuck_hockey

PACKAGES = (airpuck, airpuck_hockey)


def modules():
    for package in PACKAGES:
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".cli" not in info.name:  # its help texts are the documentation
                yield importlib.import_module(info.name)


def public_functions(module):
    """Functions and methods that a module defines, with the name of their holder."""
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
    """`module.name` of each entry point that a package's docstring lists."""
    for package in PACKAGES:
        for info in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            text = importlib.import_module(info.name).__doc__ or ""
            for name in re.findall(r"`(\w+\.\w+)`", text.partition("Entry points:")[2]):
                yield f"{info.name}.{name}"


def exists(name: str) -> bool:
    module, _, attribute = name.rpartition(".")
    return hasattr(importlib.import_module(module), attribute)


ENTRIES = set(entry_points())


def wrong_with(function, full: bool) -> str:
    """Return what a docstring omits or invents; empty if it is right."""
    text = inspect.getdoc(inspect.unwrap(function))
    if not text:
        return "no docstring"
    if "see `" in text.splitlines()[0]:
        return ""  # documented where the interface is defined
    documentation = docstring_parser.parse(text, docstring_parser.DocstringStyle.NUMPYDOC)
    documented = {
        part.strip().lstrip("*") for p in documentation.params for part in p.arg_name.split(",")
    }
    signature = inspect.signature(inspect.unwrap(function))
    if invented := documented - set(signature.parameters):
        return f"documents {invented}, which it does not take"
    if not full:
        return ""
    if missing := set(signature.parameters) - {"self", "cls"} - documented:
        return f"does not document {missing}"
    returns = documentation.returns or documentation.many_returns or "Yields" in text
    if not returns and signature.return_annotation not in (inspect.Signature.empty, None, "None"):
        return "does not say what it returns"
    return ""


def test_entry_points_exist():
    assert len(ENTRIES) > 50
    assert not [name for name in ENTRIES if not exists(name)]


def test_docstrings_match_signatures():
    public = [getattr(package, name) for package in PACKAGES for name in dir(package)]
    exported = {f"{one.__module__}.{one.__name__}" for one in public if hasattr(one, "__module__")}
    wrong = {}
    for module in modules():
        for holder, name, function in public_functions(module):
            full = f"{module.__name__}.{holder}" in exported | ENTRIES
            if reason := wrong_with(function, full):
                wrong[f"{module.__name__}.{name}"] = reason
    assert not wrong
