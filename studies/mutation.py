"""Do the tests notice? Random one-line mistakes in a package, each against the package's tests.

    python studies/mutation.py hockey planning [--count 100] [--seed 0] [--out out/mutation]

Draws mistakes at random from all places where one can be made: a sign, a comparison, a number, a
condition, a minimum for a maximum, a statement left out. Docstrings, messages, annotations,
decorators, assertions and `__repr__` are left alone. For each mistake the tests that run the line
are run, quick ones first, until one fails. A mistake that no test notices survives; one whose tests
run far beyond their usual time is counted as noticed.

Prints the survivors and a table. Results are kept in a file per package, so that a run can be
stopped and resumed. A survivor is tried again when the tests have changed.

One process with everything imported forks for each mistake, and only the modules that depend on the
changed one are imported anew. That takes seconds where a new interpreter takes half a minute.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import json
import os
import random
import re
import resource
import signal
import sys
import threading
import time
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src" / "airpuck"

#: What stands for what. Of comparisons the second is taken where numbers are counted: real numbers
#: are never equal.
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
#: Keywords that check or label, and change no result.
IDLE_KEYWORDS = {"strict", "stacklevel", "check", "help"}
#: A test that takes longer than this is not run [s of a processor].
SLOW = 3.0
#: Tests are stopped after twice their usual time and this [s of a processor], or after so many
#: times that by the clock, which also knows other work on the machine.
PATIENCE, LOADED = 10.0, 10.0
#: No mistake takes more memory [bytes].
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
    #: Of the file without it.
    source: str

    @property
    def key(self) -> str:
        """What it is known by in the file of results."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def mutated(self) -> bytes:
        """Return the file with the mistake."""
        text = (SOURCES / self.path).read_bytes()
        return text[: self.start] + self.after.encode() + text[self.end :]

    def __str__(self) -> str:
        before = " ".join(self.before.split())
        return f"{self.path}:{self.line}: {before} -> {self.after}"


class Mistakes(ast.NodeVisitor):
    """Finds where in a file a mistake can be made: spans with what may stand there instead."""

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
        """Note an operator between two operands."""
        start, end = self.span(left)[1], self.span(right)[0]
        gap = self.text[start:end].decode()
        pattern = re.escape(old).replace(r"\ ", r"\s+")
        operator = re.search(pattern, gap)
        if operator and "#" not in gap:
            offset = len(gap[: operator.start()].encode())
            self.found.append((start + offset, start + offset + len(operator[0].encode()), new))

    def negated(self, test: ast.expr) -> None:
        """Note a condition."""
        self.found.append((*self.span(test), (f"not ({self.piece(test)})",)))

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Look at the defaults and the body."""
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
        """Look at the body."""
        for statement in node.body:
            self.visit(statement)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Look at the value."""
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Leave messages alone."""

    def visit_Assert(self, node: ast.Assert) -> None:
        """Leave assertions alone."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Leave messages alone."""

    def visit_Compare(self, node: ast.Compare) -> None:
        """Turn a comparison round, or move its boundary by one."""
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
        """Change a number by one, and truth."""
        value = node.value
        if isinstance(value, bool):
            self.found.append((*self.span(node), (str(not value),)))
        elif isinstance(value, int | float):
            self.found.append((*self.span(node), (repr(value + 1),)))

    def visit_Call(self, node: ast.Call) -> None:
        """Call the opposite; leave reports alone."""
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
        """Turn a condition round."""
        if self.piece(node.test) == "TYPE_CHECKING":
            return
        self.negated(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        """Turn a condition round."""
        self.negated(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        """Turn filters round."""
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
        """Leave out what changes an object."""
        if self.inside and isinstance(node.targets[0], ast.Attribute | ast.Subscript):
            self.found.append((*self.span(node), ("pass",)))
        self.generic_visit(node)


def mutants(package: str, count: int, seed: int) -> list[Mutant]:
    """Draw mistakes in the modules of a package, no two at one place."""
    places = []
    for path in sorted((SOURCES / package).rglob("*.py")):
        text = path.read_bytes()
        digest = hashlib.sha256(text).hexdigest()[:12]
        name = str(path.relative_to(SOURCES))
        for start, end, choices in sorted(Mistakes(text).found):
            places.append(
                (name, text.count(b"\n", 0, start) + 1, start, end, text, choices, digest)
            )
    draw = random.Random(f"{package} {seed}")
    drawn = []
    for name, line, start, end, text, choices, digest in draw.sample(
        places, min(count, len(places))
    ):
        after = draw.choice(choices)
        mutant = Mutant(name, line, start, end, text[start:end].decode(), after, digest)
        compile(mutant.mutated(), name, "exec")
        drawn.append(mutant)
    return drawn


@dataclass
class Test:
    """What is known of a test: how long it takes, and which lines of the package it runs."""

    node: str
    seconds: float = 0.0
    passed: bool = True


class Watch:
    """A pytest plugin that notes times, outcomes, and the lines that each test runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = f"{folder}{os.sep}"
        self.tests: dict[str, Test] = {}
        self.lines: dict[str, set[tuple[str, int]]] = defaultdict(set)
        self.now: set[tuple[str, int]] = set()

    def _call(self, frame: Any, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        if not name.startswith(self.folder):
            return None
        now = self.now

        def line(frame: Any, event: str, argument: Any) -> Any:
            now.add((name, frame.f_lineno))
            return line

        return line(frame, event, argument)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Follow a test with its fixtures."""
        test = self.tests[item.nodeid] = Test(item.nodeid)
        self.now = self.lines[item.nodeid]
        threading.settrace(self._call)
        sys.settrace(self._call)
        began = sum(os.times()[:4])
        yield
        test.seconds = sum(os.times()[:4]) - began
        sys.settrace(None)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure in any of a test's parts."""
        self.tests[report.nodeid].passed &= report.passed


class Chosen:
    """A pytest plugin that runs some tests in a given order, and keeps the name of a failure."""

    def __init__(self, order: list[str]) -> None:
        self.order = {node: k for k, node in enumerate(order)}
        self.failed = ""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose and sort."""
        items[:] = sorted(
            (item for item in items if item.nodeid in self.order),
            key=lambda item: self.order[item.nodeid],
        )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the first failure."""
        if report.failed and not self.failed:
            self.failed = report.nodeid


def in_a_child(work: Callable[[], Any], limit: float) -> Any:
    """Return what a function gives in a fork of this process; None if it takes too long.

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
        # One line, not all until the end: a child of the child may live on.
        said = pipe.readline()
    timer.cancel()
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if late.is_set() or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return None
    return json.loads(said) if said else {"failed": "crash", "why": "the process ended"}


ARGUMENTS = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "-m", "not study and not browser"]


def tested(files: list[str], *plugins: Any, stop: bool = True) -> int:
    """Run pytest in this process."""
    arguments = ARGUMENTS if stop else [a for a in ARGUMENTS if a != "-x"]
    return int(pytest.main([*arguments, *files], plugins=list(plugins)))


def baseline(package: str, out: Path) -> tuple[list[Test], dict[str, set[tuple[str, int]]]]:
    """Run the tests of a package as it is, file by file where they are not known yet.

    Also imports here what they imported.
    """
    files = sorted((ROOT / "tests" / package).rglob("test_*.py"))
    sources = b"".join(path.read_bytes() for path in sorted((SOURCES / package).rglob("*.py")))
    kept = out / f"{package}-baseline.json"
    known = json.loads(kept.read_text()) if kept.exists() else {}
    keys = {
        str(path.relative_to(ROOT)): hashlib.sha256(sources + path.read_bytes()).hexdigest()
        for path in files
    }
    missing = [name for name, key in keys.items() if known.get(name, {}).get("key") != key]

    def work(files: list[str]) -> Any:
        watch = Watch(SOURCES / package)
        tested(files, watch, stop=False)
        return {
            "tests": [asdict(test) for test in watch.tests.values()],
            "lines": {node: sorted(found) for node, found in watch.lines.items()},
            "modules": list(sys.modules),
        }

    tested(["--collect-only", f"tests/{package}"])
    for name in missing:
        known[name] = {**in_a_child(lambda name=name: work([name]), 3600.0), "key": keys[name]}
        kept.write_text(json.dumps(known))
    for name in dict.fromkeys(name for file in keys for name in known[file]["modules"]):
        if name != "__main__" and name not in sys.modules:
            with suppress(Exception), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                importlib.import_module(name)
    tests = [Test(**test) for file in keys for test in known[file]["tests"]]
    return tests, {
        node: {(name, line) for name, line in lines}
        for file in keys
        for node, lines in known[file]["lines"].items()
    }


def imported(path: Path) -> set[str]:
    """Return what a module imports when it is imported."""
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
    """Return the loaded modules that a changed one could have changed, itself among them."""
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
    """Let everything that depends on a module be imported anew."""
    for name in dependents(module):
        parent, _, last = name.rpartition(".")
        sys.modules.pop(name, None)
        with suppress(AttributeError, KeyError):
            delattr(sys.modules[parent], last)


def attempt(mutant: Mutant, order: list[str]) -> dict[str, Any]:
    """Make a mistake in this process, and run tests until one fails."""
    module = "airpuck." + mutant.path.removesuffix(".py").replace("/", ".").removesuffix(
        ".__init__"
    )
    original = SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, fullname: str) -> Any:
        if fullname == module:
            return self.source_to_code(mutant.mutated(), str(SOURCES / mutant.path))  # type: ignore[arg-type]
        return original(self, fullname)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
    forget(module)
    chosen = Chosen(order)
    files = list(dict.fromkeys(node.partition("::")[0] for node in order))
    status = tested(files, chosen)
    return {"failed": chosen.failed or ("" if status == 0 else "import")}


def order_for(
    mutant: Mutant, tests: list[Test], lines: dict[str, set[tuple[str, int]]]
) -> list[str]:
    """Return the tests of the files that run a line: quick ones first, then those that run it.

    A module's fixture, or a compiled program, runs a line for one test only, so that the other
    tests of its file come, too. What runs when a module is imported concerns all who import it.
    """
    path = str(SOURCES / mutant.path)
    last = mutant.line + mutant.before.count("\n")
    runs = {
        test.node
        for test in tests
        if any((path, line) in lines[test.node] for line in range(mutant.line, last + 1))
    }
    if not runs:
        runs = {t.node for t in tests if any(name == path for name, _ in lines[t.node])}
    files = {node.partition("::")[0] for node in runs}
    chosen = [t for t in tests if t.passed and t.node.partition("::")[0] in files]
    chosen = [t for t in chosen if t.seconds < SLOW]
    chosen.sort(key=lambda t: (t.node not in runs, t.seconds > 0.5, t.node.partition("::")[0]))
    return [test.node for test in chosen]


def state_of_tests(package: str) -> str:
    """Return a hash of the tests."""
    shared = [*ROOT.glob("tests/*.py"), *ROOT.glob("tests/apparatus/*.py")]
    paths = [*sorted((ROOT / "tests" / package).rglob("*.py")), *sorted(shared)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:12]


def study(package: str, count: int, seed: int, out: Path) -> list[tuple[Mutant, dict[str, Any]]]:
    """Return what became of each mutant; keep it in a file."""
    out.mkdir(parents=True, exist_ok=True)
    file, state = out / f"{package}.jsonl", state_of_tests(package)
    known: dict[str, dict[str, Any]] = {}
    if file.exists():
        for row in map(json.loads, file.read_text().splitlines()):
            known[row["key"]] = row
    drawn = mutants(package, count, seed)

    def settled(mutant: Mutant) -> bool:
        row = known.get(mutant.key)
        return row is not None and (row["killed"] or row["tests"] == state)

    if not all(map(settled, drawn)):
        began = time.monotonic()
        tests, lines = baseline(package, out)
        usual = {test.node: test.seconds for test in tests}
        print(
            f"{package}: {len(tests)} tests, {time.monotonic() - began:.0f} s;"
            f" left out: {sum(t.seconds >= SLOW for t in tests)} slow,"
            f" {sum(not t.passed for t in tests)} skipped or failing",
            flush=True,
        )
        for mutant in drawn:
            if settled(mutant):
                continue
            order = order_for(mutant, tests, lines)
            limit = PATIENCE + 2 * sum(usual[node] for node in order)
            began = time.monotonic()
            found = (
                in_a_child(lambda m=mutant, o=order: attempt(m, o), limit)
                if order
                else {"failed": ""}
            )
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
            print(f"{mark} {row['seconds']:5.1f} s {mutant}  [{row['by']}]", flush=True)
    return [(mutant, known[mutant.key]) for mutant in drawn]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("packages", nargs="+")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutation")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    table = []
    for package in options.packages:
        found = study(package, options.count, options.seed, options.out)
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
