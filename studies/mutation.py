"""Do the tests notice mistakes? Random one-line mistakes against the tests of a package.

    python studies/mutation.py planning airpuck_hockey/player [--count 100] [--seed 0] [--slow 2.5]

Draws mistakes at random from all places where one can be made: a sign, a comparison, a number, a
condition, a minimum for a maximum, a statement left out. Docstrings, messages, annotations,
decorators, assertions and `__repr__` are left alone. For each mistake the tests that call the
function are run, quick ones first, until one fails. A mistake that no test notices survives; one
whose tests run far beyond their usual time is counted as noticed.

Prints the survivors and a table. Results are kept in a file per package, so that a run can be
stopped and resumed. A survivor is tried again when the tests have changed.

One process that has collected the tests forks for each mistake and gives the changed function its
new code. Where a module's constants or a class change, the fork reimports what depends on them.
So a mistake costs only the time of its tests, whereas a new interpreter takes half a minute to
start.
"""

from __future__ import annotations

import argparse
import ast
import gc
import hashlib
import inspect
import json
import os
import re
import resource
import signal
import sys
import threading
import time
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src" / "airpuck"
HOCKEY = ROOT / "packages" / "airpuck-hockey"

#: Replacements of operators. A comparison is replaced by the second one only between counts: real
#: numbers are never equal.
COMPARISONS: dict[type, tuple[str, ...]] = {
    ast.Lt: ("<", ">=", "<="),
    ast.LtE: ("<=", ">", "<"),
    ast.Gt: (">", "<=", ">="),
    ast.GtE: (">=", "<", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
ARITHMETIC: dict[type, tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
}
_PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("argmin", "argmax"),
    ("any", "all"),
    ("sin", "cos"),
    ("floor", "ceil"),
)
CALLS = {a: b for pair in _PAIRS for a, b in (pair, pair[::-1])}
#: Keywords that only check or label: they change no result.
IDLE_KEYWORDS = {"strict", "stacklevel", "check", "help"}
#: A test that takes longer than this is not run [s of a processor].
SLOW = 2.5
#: A quick test is run before others [s of a processor].
QUICK = 0.3
#: Tests are stopped after twice their usual time plus this [s of a processor], or after this
#: multiple of that by the clock, since other work may slow the machine down.
PATIENCE, LOADED = 10.0, 10.0
#: Memory limit of a run with a mistake [bytes].
MEMORY = 6 << 30


@dataclass(frozen=True)
class Mutant:
    """One mistake: bytes of a file that are replaced by others."""

    path: str
    line: int
    start: int
    end: int
    before: str
    after: str
    #: Hash of the function, class or statement without the mistake.
    source: str

    @property
    def key(self) -> str:
        """The mistake's key in the file of results."""
        named = self.path, self.before, self.after, self.source
        return hashlib.sha256(repr(named).encode()).hexdigest()[:16]

    @property
    def module(self) -> str:
        """Name of the module."""
        name = self.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        return name if name.startswith("airpuck_hockey.") else f"airpuck.{name}"

    @property
    def file(self) -> Path:
        """The file without the mistake."""
        return sources(self.path) / self.path

    def mutated(self) -> bytes:
        """Return the file with the mistake."""
        text = self.file.read_bytes()
        return text[: self.start] + self.after.encode() + text[self.end :]

    def __str__(self) -> str:
        before = " ".join(self.before.split())
        return f"{self.path}:{self.line}: {before} -> {self.after}"


class Mistakes(ast.NodeVisitor):
    """Finds the places in a file where a mistake can be made: spans and their replacements."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        self.starts = [0]
        for line in text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.found: list[tuple[int, int, tuple[str, ...]]] = []
        self.inside = 0
        self.visit(ast.parse(text))

    def span(self, node: ast.AST) -> tuple[int, int]:
        """Return the bytes of a node."""
        place: Any = node
        return (
            self.starts[place.lineno - 1] + place.col_offset,
            self.starts[place.end_lineno - 1] + place.end_col_offset,
        )

    def piece(self, node: ast.AST) -> str:
        """Return the text of a node."""
        start, end = self.span(node)
        return self.text[start:end].decode()

    def between(self, left: ast.AST, right: ast.AST, old: str, new: tuple[str, ...]) -> None:
        """Record an operator between two operands."""
        start, end = self.span(left)[1], self.span(right)[0]
        gap = self.text[start:end].decode()
        pattern = re.escape(old).replace(r"\ ", r"\s+")
        operator = re.search(pattern, gap)
        if operator and "#" not in gap:
            offset = len(gap[: operator.start()].encode())
            self.found.append((start + offset, start + offset + len(operator[0].encode()), new))

    def negated(self, test: ast.expr) -> None:
        """Record a condition."""
        self.found.append((*self.span(test), (f"not ({self.piece(test)})",)))

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Visit the defaults and the body."""
        if node.name in ("__repr__", "__str__"):
            return
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                self.visit(default)
        self.inside += 1
        for statement in node.body:
            self.visit(statement)
        self.inside -= 1

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        """Visit the body."""
        for statement in node.body:
            self.visit(statement)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Visit the value."""
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Skip messages."""

    def visit_Assert(self, node: ast.Assert) -> None:
        """Skip assertions."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Skip messages."""

    def visit_Compare(self, node: ast.Compare) -> None:
        """Invert a comparison, or move its boundary by one."""
        operands = [node.left, *node.comparators]
        counted = any(
            (isinstance(x, ast.Constant) and type(x.value) is int)
            or (isinstance(x, ast.Call) and self.piece(x.func) == "len")
            for x in operands
        )
        for left, right, kind in zip(operands, operands[1:], node.ops, strict=False):
            old, *new = COMPARISONS[type(kind)]
            self.between(left, right, old, tuple(new if counted else new[:1]))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        """Exchange "and" and "or"."""
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            self.between(left, right, old, (new,))
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        """Exchange an operator."""
        texts = any(
            isinstance(x, ast.JoinedStr) or (isinstance(x, ast.Constant) and type(x.value) is str)
            for x in (node.left, node.right)
        )
        if type(node.op) in ARITHMETIC and self.inside and not texts:
            old, new = ARITHMETIC[type(node.op)]
            self.between(node.left, node.right, old, (new,))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        """Leave out a sign or a "not"."""
        if isinstance(node.op, ast.USub | ast.Not | ast.Invert):
            self.found.append((*self.span(node), (f"({self.piece(node.operand)})",)))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Change a number by one, or negate a boolean."""
        value = node.value
        if isinstance(value, bool):
            self.found.append((*self.span(node), (str(not value),)))
        elif isinstance(value, int | float):
            self.found.append((*self.span(node), (repr(value + 1),)))

    def visit_Call(self, node: ast.Call) -> None:
        """Call the opposite function; skip reports."""
        name = self.piece(node.func).rpartition(".")[2]
        if name in ("warn", "warning", "info", "debug", "InputError", "isinstance"):
            return
        _, end = self.span(node.func)
        if name in CALLS:
            self.found.append((end - len(name.encode()), end, (CALLS[name],)))
        if name == "abs" and len(node.args) == 1:
            self.found.append((*self.span(node), (f"({self.piece(node.args[0])})",)))
        self.visit(node.func)
        for argument in node.args:
            self.visit(argument)
        for keyword in node.keywords:
            if keyword.arg not in IDLE_KEYWORDS:
                self.visit(keyword.value)

    def visit_If(self, node: ast.If) -> None:
        """Invert a condition."""
        if self.piece(node.test) == "TYPE_CHECKING":
            return
        self.negated(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        """Invert a condition."""
        self.negated(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        """Invert filters."""
        for test in node.ifs:
            self.negated(test)
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        """Leave out a call; docstrings stay."""
        if isinstance(node.value, ast.Constant):
            return
        if isinstance(node.value, ast.Call) and "super()" not in self.piece(node):
            self.found.append((*self.span(node), ("pass",)))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        """Leave out a change, or make the opposite one."""
        self.found.append((*self.span(node), ("pass",)))
        if type(node.op) in ARITHMETIC:
            old, new = ARITHMETIC[type(node.op)]
            self.between(node.target, node.value, old + "=", (new + "=",))
        self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> None:
        """Leave out a statement that changes an object."""
        if self.inside and isinstance(node.targets[0], ast.Attribute | ast.Subscript):
            self.found.append((*self.span(node), ("pass",)))
        self.generic_visit(node)


def sources(package: str) -> Path:
    """Return the folder that the paths of a package's modules start from."""
    return HOCKEY / "src" if package.startswith("airpuck_hockey/") else SOURCES


def named(package: str) -> str:
    """Return a package's name in the names of files."""
    return package.replace("/", "-")


def tests_of(package: str) -> Path:
    """Return the folder with the tests of a package."""
    tests = HOCKEY / "tests" if package.startswith("airpuck_hockey/") else ROOT / "tests"
    return tests / package.removeprefix("airpuck_hockey/")


def mutants(package: str, count: int, seed: int) -> list[Mutant]:
    """Draw mistakes in the modules of a package, no two at one place.

    A hash of the place decides, so code added elsewhere leaves most of the choice unchanged.
    """
    drawn = []
    for path in sorted((sources(package) / package).rglob("*.py")):
        text, seen = path.read_bytes(), Counter[tuple[str, str]]()
        statements = ast.parse(text).body
        name = str(path.relative_to(sources(package)))
        for start, end, choices in sorted(Mistakes(text).found):
            line, before = text.count(b"\n", 0, start) + 1, text[start:end].decode()
            around = next(s for s in statements if line <= (s.end_lineno or line))
            within = getattr(around, "name", ast.unparse(around))
            seen[within, before] += 1
            place = seed, name, within, before, seen[within, before]
            lot = hashlib.sha256(repr(place).encode()).hexdigest()
            after = choices[int(lot, 16) % len(choices)]
            source = hashlib.sha256(f"{ast.dump(around)} {place}".encode()).hexdigest()[:12]
            drawn.append((lot, Mutant(name, line, start, end, before, after, source)))
    chosen = [mutant for _, mutant in sorted(drawn, key=lambda pair: pair[0])[:count]]
    for mutant in chosen:
        compile(mutant.mutated(), mutant.path, "exec")
    return chosen


@dataclass
class Test:
    """A test's duration, and the functions of the package that it calls."""

    node: str
    seconds: float
    passed: bool
    #: File and first line.
    calls: set[tuple[str, int]]


class Reports:
    """A pytest plugin that records the names of failed tests."""

    def __init__(self) -> None:
        self.failed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record a failure in any phase of a test."""
        if report.failed:
            self.failed.append(report.nodeid)


class Chosen:
    """A pytest plugin that runs some tests in a given order."""

    def __init__(self, order: list[str]) -> None:
        self.order = {node: k for k, node in enumerate(order)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose and sort."""
        items[:] = sorted(
            (item for item in items if item.nodeid in self.order),
            key=lambda item: self.order[item.nodeid],
        )


class Instead:
    """A pytest plugin that passes the collected tests to a function instead of running them."""

    def __init__(self, work: Callable[[pytest.Session], None]) -> None:
        self.work = work

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Call the function."""
        self.work(session)
        return True


def run(items: list[pytest.Item], stop: bool = True) -> list[str]:
    """Run collected tests in this process; return those that fail, or the first of them."""
    reports = Reports()
    items[0].config.pluginmanager.register(reports)
    for item, following in zip(items, [*items[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if stop and reports.failed:
            break
    return reports.failed


def too_slow(signal: int, frame: Any) -> None:
    """End a slow test."""
    pytest.fail("slow")


def watched(items: list[pytest.Item], folder: Path, slow: float) -> list[dict[str, Any]]:
    """Run collected tests in this process; return duration and calls of each."""
    inside, found = f"{folder}{os.sep}", []
    calls: set[tuple[str, int]] = set()

    def call(frame: Any, event: str, argument: Any) -> None:
        code = frame.f_code
        if code.co_filename.startswith(inside):
            calls.add((code.co_filename, code.co_firstlineno))

    signal.signal(signal.SIGPROF, too_slow)
    for item in items:
        calls.clear()
        began = sum(os.times()[:4])
        signal.setitimer(signal.ITIMER_PROF, 2 * slow)
        threading.settrace(call)
        sys.settrace(call)
        failed = run([item])
        sys.settrace(None)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        seconds = sum(os.times()[:4]) - began
        found.append(
            {
                "node": item.nodeid,
                "seconds": round(seconds, 3),
                "passed": not failed,
                "calls": sorted(calls),
            }
        )
    return found


def in_a_child(work: Callable[[], Any], limit: float) -> Any:
    """Return the result of a function run in a fork of this process; None on timeout.

    The limit is in seconds of a processor.
    """
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        child = os.fork()
    if not child:
        os.setsid()
        os.close(reading)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (round(limit), round(limit) + 1))
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silence, stream)
        try:
            answer = work()
        except BaseException:
            answer = {"failed": "crash", "why": traceback.format_exc()}
        with os.fdopen(writing, "w") as pipe:
            pipe.write(json.dumps(answer) + "\n")
        os._exit(0)
    os.close(writing)
    late = threading.Event()

    def stop() -> None:
        late.set()
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)

    timer = threading.Timer(LOADED * limit, stop)
    timer.start()
    with os.fdopen(reading) as pipe:
        # Read one line, not until the end: a child of the child may keep the pipe open.
        said = pipe.readline()
    timer.cancel()
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if late.is_set() or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return None
    return json.loads(said) if said else {"failed": "crash", "why": "the process ended"}


ARGUMENTS = ["-q", "-s", "-x", "-n", "0", "-p", "no:cacheprovider"]
ARGUMENTS += ["-m", "not study and not browser"]


def tested(files: list[str], *plugins: Any) -> int:
    """Run pytest in this process."""
    return int(pytest.main([*ARGUMENTS, *files], plugins=list(plugins)))


def baseline(package: str, items: list[pytest.Item], slow: float, out: Path) -> list[Test]:
    """Run the tests of an unchanged package, file by file if they are not known yet."""
    kept = out / f"{named(package)}-baseline.json"
    folder = sources(package) / package
    known = json.loads(kept.read_text()) if kept.exists() else {}
    modules = b"".join(path.read_bytes() for path in sorted(folder.rglob("*.py")))
    files: dict[Path, list[pytest.Item]] = defaultdict(list)
    for item in items:
        files[item.path].append(item)
    found: list[Test] = []
    for path, tests in files.items():
        name, key = path.name, hashlib.sha256(modules + path.read_bytes()).hexdigest()
        before = known.get(name, {"key": "", "slow": 0.0})
        if before["key"] != key or before["slow"] < slow:
            rows = in_a_child(lambda tests=tests: watched(tests, folder, slow), 1200.0)
            known[name] = {"key": key, "slow": slow, "tests": rows}
            kept.write_text(json.dumps(known))
        for row in known[name]["tests"]:
            calls = {(file, line) for file, line in row["calls"]}
            passed = row["passed"] and row["seconds"] < slow
            found.append(Test(row["node"], row["seconds"], passed, calls))
    return found


def imported(path: Path) -> set[str]:
    """Return the modules that a module imports at import time."""
    found: set[str] = set()
    stack: list[ast.AST] = [ast.parse(path.read_bytes())]
    while stack:
        node = stack.pop()
        if isinstance(node, ast.FunctionDef) or (
            isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        ):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = path.relative_to(ROOT).with_suffix("").parts[: -node.level]
                base = ".".join((*parts, *([base] if base else [])))
            found |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
        stack += ast.iter_child_nodes(node)
    return found


def dependents(module: str) -> set[str]:
    """Return the loaded modules that a change of one module may affect, including itself."""
    ours = {
        name: imported(Path(loaded.__file__))
        for name, loaded in list(sys.modules.items())
        if name.partition(".")[0] in ("airpuck", "tests") and getattr(loaded, "__file__", None)
    }
    # Nearly all tests import public names from the package itself, by name and when they run.
    users = {
        name
        for name, found in ours.items()
        if name.startswith("tests.") and "airpuck" in found and not name.endswith("conftest")
    }
    changed, size = {module, *users}, 0
    while len(changed) > size:
        size = len(changed)
        changed |= {name for name, found in ours.items() if found & changed}
    return changed - {"airpuck", "tests", "tests.conftest"}


def forget(module: str) -> None:
    """Reimport everything that depends on a module."""
    changed, public = dependents(module), vars(sys.modules["airpuck"])
    for name in [k for k, v in public.items() if getattr(v, "__module__", "") in changed]:
        del public[name]
    for name in changed:
        parent, _, last = name.rpartition(".")
        sys.modules.pop(name, None)
        with suppress(AttributeError, KeyError):
            delattr(sys.modules[parent], last)


def codes(scope: CodeType, functions: dict[tuple[str, int], CodeType], rest: list[Any]) -> None:
    """Divide the code of a module into its functions and the code that runs at import."""
    rest += [scope.co_code, scope.co_names]
    for constant in scope.co_consts:
        if not isinstance(constant, CodeType):
            rest.append(repr(constant))
        elif constant.co_flags & inspect.CO_OPTIMIZED:
            functions[constant.co_qualname, constant.co_firstlineno] = constant
        else:
            codes(constant, functions, rest)


def functions_of(folder: Path) -> dict[tuple[str, str, int], list[FunctionType]]:
    """Return all functions that are loaded from a folder: by file, name and first line."""
    found = defaultdict(list)
    gc.unfreeze()  # the tests freeze all objects, which hides them
    for one in gc.get_objects():
        if isinstance(one, FunctionType) and one.__code__.co_filename.startswith(
            f"{folder}{os.sep}"
        ):
            code = one.__code__
            found[code.co_filename, code.co_qualname, code.co_firstlineno].append(one)
    return found


def changed_in_place(
    mutant: Mutant, loaded: dict[tuple[str, str, int], list[FunctionType]]
) -> bool:
    """Give functions the code with a mistake; return whether nothing else must change."""
    path = mutant.file
    loader: Any = find_spec(mutant.module).loader  # type: ignore[union-attr]
    old: dict[tuple[str, int], CodeType] = {}
    new: dict[tuple[str, int], CodeType] = {}
    before: list[Any] = []
    after: list[Any] = []
    codes(loader.source_to_code(path.read_bytes(), str(path)), old, before)
    codes(loader.source_to_code(mutant.mutated(), str(path)), new, after)
    if before != after or old.keys() != new.keys():
        return False
    changes = [key for key in old if old[key] != new[key]]
    users = [loaded[str(path), *key] for key in changes]
    if not users or not all(users):
        return False
    try:
        for key, functions in zip(changes, users, strict=True):
            for function in functions:
                function.__code__ = new[key]
    except ValueError:  # another number of free variables
        return False
    return True


def attempt(
    mutant: Mutant,
    order: list[str],
    items: dict[str, pytest.Item],
    loaded: dict[tuple[str, str, int], list[FunctionType]],
) -> dict[str, Any]:
    """Make a mistake in this process, and run tests until one fails."""
    if changed_in_place(mutant, loaded):
        failed = run([items[node] for node in order])
        return {"failed": failed[0] if failed else ""}
    original = SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, fullname: str) -> Any:
        if fullname == mutant.module:
            return self.source_to_code(mutant.mutated(), str(mutant.file))  # type: ignore[arg-type]
        return original(self, fullname)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
    forget(mutant.module)
    reports = Reports()
    status = tested(
        list(dict.fromkeys(node.partition("::")[0] for node in order)), Chosen(order), reports
    )
    return {"failed": reports.failed[0] if reports.failed else ("" if status == 0 else "import")}


def order_for(mutant: Mutant, tests: list[Test], spans: dict[tuple[str, int], int]) -> list[str]:
    """Return the tests that may notice a change of a function, quick ones first.

    A fixture of a module, or a compiled program, calls a function for one test only, so that the
    other quick tests of its file come, too. Code that runs when a module is imported affects all
    users of the module.
    """
    path = str(mutant.file)
    around = [
        (file, first)
        for (file, first), last in spans.items()
        if file == path and first <= mutant.line <= last
    ]
    calls = {t.node for t in tests if around and max(around) in t.calls}
    if not calls:
        calls = {t.node for t in tests if any(file == path for file, _ in t.calls)}
    files = {node.partition("::")[0] for node in calls}
    chosen = [
        t
        for t in tests
        if t.passed
        and (t.node in calls or (t.node.partition("::")[0] in files and t.seconds < QUICK))
    ]
    chosen.sort(key=lambda t: (t.node not in calls, t.seconds))
    return [test.node for test in chosen]


def spans_of(package: str) -> dict[tuple[str, int], int]:
    """Return the line ranges of functions: file and first line, and last line."""
    found = {}
    for path in (sources(package) / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.FunctionDef):
                first = min(x.lineno for x in (node, *node.decorator_list))
                found[str(path), first] = node.end_lineno or first
    return found


def state_of_tests(package: str) -> str:
    """Return a hash of the tests."""
    shared = [*ROOT.glob("tests/*.py"), *ROOT.glob("tests/apparatus/*.py")]
    paths = [*sorted(tests_of(package).rglob("*.py")), *sorted(shared)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:12]


def study(
    package: str, count: int, seed: int, slow: float, out: Path
) -> list[tuple[Mutant, dict[str, Any]]]:
    """Return the result of each mutant, and store it in a file."""
    out.mkdir(parents=True, exist_ok=True)
    file, state = out / f"{named(package)}.jsonl", state_of_tests(package)
    known: dict[str, dict[str, Any]] = {}
    if file.exists():
        for row in map(json.loads, file.read_text().splitlines()):
            known[row["key"]] = row
    drawn = mutants(package, count, seed)

    def settled(mutant: Mutant) -> bool:
        row = known.get(mutant.key)
        return row is not None and (row["killed"] or row["tests"] == state)

    def work(session: pytest.Session) -> None:
        began = time.monotonic()
        tests, spans = baseline(package, session.items, slow, out), spans_of(package)
        items = {item.nodeid: item for item in session.items}
        usual = {test.node: test.seconds for test in tests}
        loaded = functions_of(sources(package) / package)
        # Forks need not copy frozen objects.
        gc.freeze()
        print(
            f"{package}: {len(tests)} tests, {time.monotonic() - began:.0f} s;"
            f" {sum(not t.passed for t in tests)} of them slow or failing",
            file=sys.__stderr__,
            flush=True,
        )
        for mutant in drawn:
            if settled(mutant):
                continue
            order = order_for(mutant, tests, spans)
            limit = PATIENCE + 2 * sum(usual[node] for node in order)
            began = time.monotonic()
            found = {"failed": ""}
            if order:
                found = in_a_child(lambda m=mutant, o=order: attempt(m, o, items, loaded), limit)
            found = {"failed": "time limit"} if found is None else found
            row = {
                "key": mutant.key,
                "mutant": str(mutant),
                "killed": bool(found["failed"]),
                "by": found["failed"],
                "seconds": round(time.monotonic() - began, 1),
                "order": len(order),
                "tests": state,
                **({"why": found["why"]} if "why" in found else {}),
            }
            known[mutant.key] = row
            with file.open("a") as log:
                log.write(json.dumps(row) + "\n")
            mark = "killed" if row["killed"] else "SURVIVED"
            line = f"{mark} {row['seconds']:5.1f} s {mutant}  [{row['by']}]"
            print(line, file=sys.__stderr__, flush=True)

    if not all(map(settled, drawn)):
        tested([str(tests_of(package))], Instead(work))
    return [(mutant, known[mutant.key]) for mutant in drawn]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("packages", nargs="+")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--slow", type=float, default=SLOW, help="longer tests are not run")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutation")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    table = []
    for package in options.packages:
        if not tests_of(package).is_dir():
            parser.error(f"there is no package {package}; air hockey's are airpuck_hockey/NAME")
    for package in options.packages:
        found = study(package, options.count, options.seed, options.slow, options.out)
        survivors = [mutant for mutant, row in found if not row["killed"]]
        for mutant in sorted(survivors, key=str):
            print(f"survived: {mutant}")
        by = Counter(row["by"] if "::" not in row["by"] else "test" for _, row in found)
        late, killed = by["time limit"], len(found) - len(survivors)
        table.append((package, len(found), killed, late, len(survivors), killed / len(found)))
    print("\n| package | mutants | killed | of these by the time limit | survived | score |")
    print("|---|---|---|---|---|---|")
    for name, count, killed, late, left, score in table:
        print(f"| {name} | {count} | {killed} | {late} | {left} | {score:.0%} |")


if __name__ == "__main__":
    main()
