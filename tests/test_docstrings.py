"""Every public function documents every argument, and nothing that it does not have."""

import importlib
import inspect
import pkgutil

import docstring_parser
import pytest

import airpuck


def public_functions():
    for info in pkgutil.walk_packages(airpuck.__path__, "airpuck."):
        if info.name.startswith("airpuck.cli"):
            continue  # its help texts are the documentation
        module = importlib.import_module(info.name)
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != info.name:
                continue
            if inspect.isfunction(thing):
                yield f"{info.name}.{name}", thing
            elif inspect.isclass(thing):
                for method_name, method in vars(thing).items():
                    function = getattr(method, "__func__", method)
                    if not method_name.startswith("_") and inspect.isfunction(function):
                        yield f"{info.name}.{name}.{method_name}", function


FUNCTIONS = dict(public_functions())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_are_documented(name):
    function = inspect.unwrap(FUNCTIONS[name])
    text = inspect.getdoc(function)
    assert text, "no docstring"
    if "see `" in text.splitlines()[0]:
        return  # documented where the interface is defined
    documentation = docstring_parser.parse(text, docstring_parser.DocstringStyle.NUMPYDOC)
    documented = {
        part.strip().lstrip("*") for p in documentation.params for part in p.arg_name.split(",")
    }
    arguments = set(inspect.signature(function).parameters) - {"self", "cls"}
    # Dataclass attributes are documented in the class.
    assert documented == arguments
    returns = inspect.signature(function).return_annotation
    if returns not in (inspect.Signature.empty, None, "None"):
        assert documentation.returns or documentation.many_returns or "Yields" in text
