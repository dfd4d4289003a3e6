"""The exported solver of quadratic programs against DAQP, PIQP and all active sets.

    python studies/exported_qp.py --count 100000
    python studies/exported_qp.py --count 100000 --single

Programs of all kinds are drawn at random; every other one starts from a nonsensical active set.
Solutions are judged by the KKT conditions and by their distance from DAQP's, in units of the
Hessian's condition. `scaled` programs have rows and variables in units from 1e-8 to 1e8 (in single
precision 1e-4 to 1e4); the other solvers get them in plain units. PIQP solves one in ten, and one
in a hundred has few enough variables to try every active set.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

#: The tests' apparatus is imported from here.
ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    sys.path.insert(0, str(ROOT))
    from tests.apparatus import quadratic_programs as qp

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=7000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--single", action="store_true", help="compile in single precision")
    options = parser.parse_args()
    flags = ["-DAIRPUCK_SINGLE"] * options.single
    with tempfile.TemporaryDirectory() as folder:
        solver = qp.ExportedSolver(Path(folder), *flags)
    random, decades = np.random.default_rng(options.seed), 4 if options.single else 8
    statuses, apart = defaultdict(Counter), Counter()
    figures = defaultdict(lambda: defaultdict(list))
    for k in range(options.count):
        kind, small = qp.KINDS[k % len(qp.KINDS)], k % 100 == 0
        program = qp.draw(random, kind, *((3, 3) if small else ()))
        if options.single:
            program = program.rounded()
        posed, units = program, np.ones(len(program.gradient))
        if kind == "scaled":
            # Powers of two, so that no digit changes.
            units = 2.0 ** np.round(random.uniform(-decades, decades, len(units)) * np.log2(10))
            rows = random.uniform(-decades, decades, len(program.matrix)) * np.log2(10)
            posed = program.scaled(units, 2.0 ** np.round(rows))
        start = random.integers(-5, 6, len(program.lower)) if k % 2 else None
        found = solver.solve(posed, start)
        solved = found.status in qp.SOLVED
        statuses[kind][found.status] += 1
        figures[kind]["iterations"].append(found.iterations)
        if not np.isfinite(found.x).all():
            apart["not finite"] += 1
        others = {"DAQP": qp.by_daqp(program)}
        if k % 10 == 0:
            others["PIQP"] = qp.by_piqp(program)
        if small and not program.soft:
            best = qp.by_enumeration(program)
            others["all active sets"] = best is not None, best
        for name, (feasible, x) in others.items():
            if feasible != solved:
                apart[f"verdict of {name}, {kind}"] += 1
            elif solved:
                scale = np.linalg.cond(program.hessian) * max(np.linalg.norm(x), 1e-300)
                figures[kind][name].append(np.linalg.norm(found.x * units - x) / scale)
        if solved:
            figures[kind]["KKT"].append(qp.residual(posed, found))
    print(f"{options.count} programs, seed {options.seed}{', single' * options.single}")
    for kind in qp.KINDS:
        print(f"{kind}: {', '.join(f'{c} {s}' for s, c in statuses[kind].most_common())}")
        for name, values in figures[kind].items():
            p50, p99, most = np.quantile(values, [0.5, 0.99, 1])
            print(f"  {name:>16}: median {p50:.1e}, 99 % {p99:.1e}, largest {most:.1e}")
    print(f"other outcomes: {dict(apart) or 'none'}")


if __name__ == "__main__":
    from one_line import run

    run(main)
