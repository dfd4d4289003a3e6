"""Rules of the architecture: allowed imports, and what loads when."""

import ast
import importlib
import pkgutil
import pydoc
import re
import subprocess
import sys
import tokenize
from collections import Counter
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest

import airpuck
from airpuck import extend
from airpuck.cli.app import known_commands

ROOT = Path(airpuck.__file__).parent
TESTS = Path(__file__).parent
#: The distribution of air hockey, which builds on this one; it need not be installed.
HOCKEY = TESTS.parent / "packages" / "airpuck-hockey"

#: Packages from the lowest layer up: each may import itself and the ones before it.
ORDER = (
    "boundary",
    "craft",
    "compute",
    "physics",
    "model",
    "data",
    "recording",
    "deviation",
    "preprocessing",
    "estimate",
    "evaluation",
    "faults",
    "identification",
    "control",
    "planning",
    "flight",
    "twin",
    "judgement",
    "experiment_design",
    "fleet",
    "live",
    "commissioning",
    "campaigns",
    "export",
    "report",
    "web",
    "cli",
)
#: The same of airpuck_hockey, and its modules.
HOCKEY_ORDER = ("puck", "player", "game", "matches", "export", "web", "cli")
MODULES = sorted(ROOT.rglob("*.py"))
HOCKEY_ROOT = HOCKEY / "src" / "airpuck_hockey"
HOCKEY_MODULES = sorted(HOCKEY_ROOT.rglob("*.py"))
HOUSE = [*MODULES, *HOCKEY_MODULES]
ALL_TESTS = [*TESTS.rglob("*.py"), *(HOCKEY / "tests").rglob("*.py")]
EXAMPLES = TESTS.parent / "examples"
#: Lines of code in both distributions, of which the aim is 36 000, and in air hockey alone.
MOST_LINES = 43_999
MOST_HOCKEY_LINES = 4_710
#: Modules and commands of both distributions, and lines of their tests.
MOST_MODULES, MOST_COMMANDS, MOST_TEST_LINES = 290, 41, 54_000
#: Names in `airpuck.extend`.
MOST_EXTEND = 115


@cache
def imports(path: Path) -> set[str]:
    """Every module that a file imports, wherever in it; a public name counts as its module."""
    inside = path.relative_to(ROOT).parts[:-1] if path.is_relative_to(ROOT) else ()
    return imported(tree(path), inside)


@cache
def tree(path: Path) -> ast.Module:
    """The syntax of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(source: ast.Module, package: tuple[str, ...] = ()) -> set[str]:
    """Every module that a source in a package of airpuck imports."""
    found = set()
    for node in ast.walk(source):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = ("airpuck", *package)[: len(package) + 2 - node.level] if node.level else ()
            module = ".".join((*above, *([node.module] if node.module else [])))
            if module == "airpuck":
                found |= {home(alias.name) for alias in node.names}
            else:
                found.add(module)
        elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "airpuck":
            found.add(home(node.attr))
    return found


def home(name: str) -> str:
    """Return the module that `airpuck.name` is or comes from."""
    if (ROOT / name).is_dir():
        return f"airpuck.{name}"
    return getattr(getattr(airpuck, name), "__module__", "airpuck")


def room(module: str) -> str:
    """`airpuck.physics.thrust` -> `physics`."""
    return module.split(".")[1] if module.count(".") else ""


@pytest.mark.parametrize(
    "source",
    [
        "from airpuck.twin.twin import Twin",
        "import airpuck.twin.twin",
        "from airpuck import twin",
        "from airpuck import Twin",
        "import airpuck\nairpuck.Twin()",
        "import airpuck\nairpuck.twin.twin.Twin()",
        "def later():\n    from airpuck import Twin",
        "from ..twin import twin",
        "from .. import twin",
        "from ..twin.twin import Twin",
    ],
)
def test_every_form_of_import_is_recognised(source):
    assert "twin" in {room(module) for module in imported(ast.parse(source), ("physics",))}


@pytest.mark.parametrize(
    ("package", "order", "modules"),
    [("airpuck", ORDER, MODULES), ("airpuck_hockey", HOCKEY_ORDER, HOCKEY_MODULES)],
    ids=["airpuck", "airpuck_hockey"],
)
def test_imports_go_downwards(package, order, modules):
    level, upwards = {room: number for number, room in enumerate(order)}, []
    for path in modules:
        own = path.parts[path.parts.index(package) + 1].removesuffix(".py")
        for module in imports(path) if own not in ("__init__", "__main__", "extend") else ():
            if module.startswith(f"{package}.") and level[room(module)] > level[own]:
                upwards.append(f"{path.name} in {own} imports {module}")
    assert len(modules) > 30
    assert not upwards


def test_airpuck_does_not_import_air_hockey():
    users = [path.name for path in MODULES for name in imports(path) if "airpuck_hockey" in name]
    assert not users


def test_air_hockey_imports_only_what_airpuck_documents():
    public = {"airpuck": set(dir(airpuck)), "airpuck.extend": set(dir(extend))}
    others, used = [], set()
    for path in HOCKEY_MODULES:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Import):
                assert not [one.name for one in node.names if one.name.startswith("airpuck.")]
            elif isinstance(node, ast.ImportFrom) and re.match(r"airpuck(\.|$)", node.module or ""):
                names = {alias.name for alias in node.names}
                others += [f"{node.module}.{n}" for n in names - public.get(node.module, set())]
                used |= names if node.module == "airpuck.extend" else set()
    assert not others
    for path in EXAMPLES.rglob("*.py"):
        used |= {name for module, name in users_imports(path) if module == "airpuck.extend"}
    assert used == public["airpuck.extend"]  # a name that nobody needs stays private


def users_code(path: Path) -> ast.Module:
    """The syntax of a user's file, or of a page's code cells."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        cells = re.findall(r"```\{code-cell\}.*?\n(.*?)```", source, re.DOTALL)
        cells = [cell for cell in cells if ".py" in cell or not cell.startswith("%%writefile")]
        source = "\n".join(re.sub(r"^[%:!].*", "", cell, flags=re.MULTILINE) for cell in cells)
    return ast.parse(source)


def users_imports(path: Path) -> list[tuple[str, str]]:
    """Modules of the two distributions, and what a user's file or page imports from them."""
    found = []
    for node in ast.walk(users_code(path)):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(str(node.module), alias.name) for alias in node.names]
    return [pair for pair in found if re.match(r"airpuck(_hockey)?(\.|$)", pair[0])]


USERS_FILES = [
    *EXAMPLES.rglob("*.py"),
    *(TESTS.parent / "docs" / "tutorials").glob("*.md"),
    *(TESTS.parent / "docs" / "howto").glob("*.md"),
]


@pytest.mark.parametrize("path", USERS_FILES, ids=lambda path: path.stem)
def test_examples_and_tutorials_import_public_names_only(path):
    """Names of airpuck; a page of a report also uses `airpuck.extend`."""
    public = {"airpuck", "airpuck_hockey", *(["airpuck.extend"] if "report" in str(path) else [])}
    assert {module for module, _ in users_imports(path)} <= public
    chains = [ast.unparse(n) for n in ast.walk(users_code(path)) if isinstance(n, ast.Attribute)]
    for chain in chains:
        if re.fullmatch(r"airpuck(_hockey)?(\.\w+)+", chain):
            pkgutil.resolve_name(chain)  # AttributeError if there is none


def test_few_names_are_reserved_for_extensions():
    """Lower the number when a name is no longer needed, or a better seam replaces several."""
    assert len(dir(extend)) <= MOST_EXTEND


@pytest.mark.parametrize(
    ("package", "rooms"),
    [
        ("matplotlib", {"report"}),
        ("jax", {"compute", "evaluation", "identification", "twin"}),
        (
            "scipy",
            {
                "control",
                "deviation",
                "evaluation",
                "faults",
                "fleet",
                "flight",
                "identification",
                "planning",
                "preprocessing",
                "recording",
                "twin",
            },
        ),
        ("casadi", {"compute", "export", "planning"}),
        ("mujoco", {"export"}),
        ("typer", {"cli"}),
        ("rosbags", {"recording", "live"}),
        ("cyclonedds", {"live"}),
        ("websockets", {"web"}),
        ("mcap", {"recording"}),
        ("gymnasium", {"export"}),
        ("pettingzoo", {"export"}),
        ("dask", {"campaigns"}),
        ("distributed", {"campaigns"}),
    ],
)
def test_heavy_packages_are_imported_only_where_allowed(package, rooms):
    users = {
        path.relative_to(ROOT).parts[0]
        for path in MODULES
        for module in imports(path)
        if module.split(".")[0] == package
    }
    assert users <= rooms


def test_the_physics_imports_only_numerical_modules():
    for path in (ROOT / "physics").glob("*.py"):
        outside = {m.split(".")[0] for m in imports(path)} - {
            "__future__",
            "airpuck",
            "collections",
            "dataclasses",
            "functools",
            "itertools",
            "jaxtyping",
            "math",
            "numpy",
            "typing",
        }
        assert not outside, f"{path.name} imports {outside}"


def test_no_module_exceeds_500_lines():
    long = {p.name: n for p in HOUSE if (n := len(p.read_text().splitlines())) > 500}
    assert not long


def test_class_names_are_unique():
    """Check type aliases, too; lower-case letters tell them from constants."""
    names = Counter(
        name
        for path in HOUSE
        for node in tree(path).body
        for name in [getattr(node, "name", ""), *map(ast.unparse, getattr(node, "targets", ()))]
        if re.fullmatch(r"_?[A-Z]\w*[a-z]\w*", name)
    )
    assert not [name for name, count in names.items() if count > 1]


@pytest.mark.parametrize(
    "package", [ROOT / room for room in ORDER] + [HOCKEY_ROOT / room for room in HOCKEY_ORDER]
)
def test_modules_of_a_package_have_no_circular_imports(package):
    left = {
        f"{package.parent.name}.{package.name}.{path.stem}": imports(path)
        for path in package.glob("[!_]*.py")
    }
    assert left
    while free := [name for name, used in left.items() if not used & left.keys() - {name}]:
        left = {name: used for name, used in left.items() if name not in free}
    assert not left


#: Packages that take long to import.
HEAVY = {"casadi", "cyclonedds", "jax", "matplotlib", "rosbags", "scipy"}


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("airpuck", {*HEAVY, "numpy", "pydantic", "jaxtyping"}),
        ("airpuck.cli", {*HEAVY, "numpy", "pydantic", "jaxtyping"}),
        ("airpuck.model.model_file", HEAVY),
        ("airpuck_hockey.web.page", {"casadi", "jax", "matplotlib", "scipy.optimize"}),
        pytest.param(
            "airpuck.judgement.study",
            {"casadi", "matplotlib", "rosbags", "scipy.optimize", "scipy.stats"},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_importing_does_not_load_heavy_packages(module, heavy):
    code = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not heavy & set(loaded)


def test_help_lists_all_public_names_by_group():
    assert len(pydoc.plain(pydoc.render_doc(airpuck)).splitlines()) <= 150
    listed = [name for names in help_groups(airpuck).values() for name in names]
    assert sorted(listed) == sorted([*dir(airpuck), "export"])


def help_groups(module) -> dict[str, list[str]]:
    """Names that a module's docstring lists after "help(", by group."""
    text = module.__doc__.partition("help(")[2]
    groups = re.findall(r"^([A-Z].*)\n((?:    .*\n)+)", text, re.MULTILINE)
    return {title: [name.strip() for name in names.split(",")] for title, names in groups}


def test_help_for_extensions_lists_all_names_by_the_groups_of_the_stub():
    assert len(pydoc.plain(pydoc.render_doc(extend)).splitlines()) <= 150
    groups, title = {}, ""
    for line in Path(extend.__file__).with_suffix(".pyi").read_text("utf-8").splitlines():
        if line.startswith("# ") and ": " in line:
            title = line[2:].partition(":")[0]
        for name in re.findall(r"\b(\w+) as \1\b", line):
            groups.setdefault(title, []).append(name)
    assert help_groups(extend) == groups
    assert sorted(name for names in groups.values() for name in names) == sorted(dir(extend))


def test_a_misspelt_public_name_suggests_the_right_one():
    with pytest.raises(AttributeError, match="did you mean 'identify'"):
        _ = airpuck.identfy


def test_every_public_name_can_be_imported():
    for name in dir(airpuck):
        assert getattr(airpuck, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = airpuck.nonsense


@pytest.mark.slow
def test_imports_of_studies_benchmarks_and_examples_exist():
    def exists(module: str, name: str) -> bool:
        with suppress(ImportError):
            if hasattr(importlib.import_module(module), name):
                return True
            return bool(importlib.import_module(f"{module}.{name}"))
        return False

    folders = (TESTS.parent / folder for folder in ("studies", "benchmarks", "examples"))
    missing = [
        f"{path.name}:{node.lineno}: {node.module}.{alias.name}"
        for folder in folders
        for path in sorted(folder.rglob("*.py"))
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("airpuck")
        for alias in node.names
        if not exists(str(node.module), alias.name)
    ]
    assert not missing


def test_no_package_is_named_like_a_public_function():
    # Importing airpuck.x makes the module an attribute of airpuck, over any function of that name.
    rooms = {path.stem if path.is_file() else path.name for path in ROOT.iterdir()}
    assert not rooms & set(dir(airpuck))


def test_long_functions_state_their_reason():
    long = [
        f"{path.name}: {node.name}"
        for path in HOUSE
        for node in ast.walk(tree(path))
        if isinstance(node, ast.FunctionDef)
        and node.end_lineno - node.lineno > 60
        and code_lines(node, path.read_text(encoding="utf-8").splitlines()) > 60
        and "Long because" not in (ast.get_docstring(node) or "")
    ]
    assert not long


def statement_lines(path: Path) -> int:
    """Return a module's lines of code: those that hold part of a statement, docstrings aside."""
    kept: set[int] = set()
    docstrings = {
        id(node.body[0])
        for node in ast.walk(tree(path))
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and ast.get_docstring(node, clean=False) is not None
    }
    said = {
        line
        for node in ast.walk(tree(path))
        if id(node) in docstrings
        for line in range(node.lineno, node.end_lineno + 1)
    }
    none = {"COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER", "ENCODING"}
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if tokenize.tok_name[token.type] not in none:
                kept.update(range(token.start[0], token.end[0] + 1))
    return len(kept - said)


def test_the_code_does_not_grow():
    """Lower the limit when the code has shrunk; whoever adds something makes room for it."""
    assert sum(map(statement_lines, HOUSE)) <= MOST_LINES
    assert sum(map(statement_lines, HOCKEY_MODULES)) <= MOST_HOCKEY_LINES


def test_modules_commands_and_tests_do_not_grow():
    """Lower the limits when the numbers fall; a new module or command must replace another."""
    assert len(HOUSE) <= MOST_MODULES
    assert len(known_commands()) <= MOST_COMMANDS
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in ALL_TESTS)
    assert lines <= MOST_TEST_LINES


def private_imports(path: Path) -> list[str]:
    """Return private names that a test imports without a comment that states the reason."""
    lines, found = path.read_text(encoding="utf-8").splitlines(), []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("airpuck"):
            private = [alias.name for alias in node.names if alias.name.startswith("_")]
            said = lines[node.lineno - 2].strip().startswith("#") or any(
                "  # " in line for line in lines[node.lineno - 1 : node.end_lineno]
            )
            if private and not said:
                found.append(f"{path.name}:{node.lineno}: {', '.join(private)}")
    return found


def test_private_imports_of_tests_state_their_reason():
    assert not [place for path in ALL_TESTS for place in private_imports(path)]


def test_helpers_shared_by_tests_are_in_the_apparatus():
    shared = [
        f"{path.name}: {node.module}"
        for path in ALL_TESTS
        if path.name.startswith("test_")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ImportFrom) and re.search(r"(^|\.)test_", node.module or "")
    ]
    assert not shared


def code_lines(function: ast.FunctionDef, lines: list[str]) -> int:
    """Lines of a body without its docstring, comments and blank lines."""
    statements = function.body[1:] if ast.get_docstring(function) else function.body
    if not statements:
        return 0
    body = lines[statements[0].lineno - 1 : function.end_lineno]
    return sum(bool(line.strip()) and not line.strip().startswith("#") for line in body)
