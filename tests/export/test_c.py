"""The controller in C against the controller in Python."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import airpuck
from airpuck import InputError, Plan, SetPoint, TrackingController, Tuning
from airpuck.control.horizon import Condensed
from airpuck.control.predictive import SoftLimits
from airpuck.control.tuning import default_tuning

from ..apparatus.c_programs import SANITIZED, SINGLE, STRICT, build, compiler
from ..apparatus.compiled_controllers import CompiledController, compare, library
from ..apparatus.export_crafts import ALL_EFFECTS, FOUR, ON_OFF, PAPER
from ..apparatus.models import scaled

MODELS = {**PAPER, "all effects": ALL_EFFECTS, "four propellers": FOUR}
M4 = PAPER["M4"]
HOME = SetPoint(0.0, 0.0, 0.0)
#: Inputs of the address sanitizer: exit on an error, without a search for leaks.
ENVIRONMENT = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}


#: Statuses after which a plan of the predictive law is in force.
PLANNED = ("optimal", "softened")


def predictive() -> Tuning:
    """A short horizon with every kind of limit."""
    limits = SoftLimits(speed_m_s=0.8, spin_rad_s=5.0, keep_out_m=((0.4, 0.2, 0.2),))
    return default_tuning().with_law("mpc", horizon_s=0.2, limits=limits)


def program(folder: Path, main: str, *options: str, using: str = "gcc") -> Path:
    """Compile one of the exported programs."""
    sources = [p for p in folder.glob("airpuck*.c") if "selftest" not in p.name]
    return build(folder / "program", [*sources, folder / main], *options, using=using)


def selftest(
    folder: Path, *options: str, flight: str = "golden.csv"
) -> subprocess.CompletedProcess:
    """Compare the flight of an export with its repetition by the compiled controller."""
    words = [program(folder, "airpuck_selftest.c", *options), folder / flight]
    return subprocess.run(words, capture_output=True, text=True, env=ENVIRONMENT)


@pytest.fixture(scope="session")
def exported(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("c") / "m4"
    airpuck.export.write(M4, "c", folder)
    return folder


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.study] * (n in ("M1", "M2", "M3"))) for n in MODELS]
)
def test_commands_and_states_equal_those_in_python(name, tmp_path):
    model = MODELS[name]
    python = TrackingController(model, HOME, compiled=False)
    c = CompiledController(library(model, tmp_path / "c"), model)
    found = compare(python, c, 400 if name == "M4" else 120)
    assert found.same == 1
    # Where thrusts are not unique, small weights choose, and rounding shows.
    assert found.worst("command") < 1e-8
    assert found.worst("state") < 1e-9
    assert "exact" in found.seen
    if name == "M4":
        assert {"scaled", "nearest", "stale pose", "bad input", "jumping pose"} <= set(found.seen)


@pytest.mark.parametrize("law", ["lqr", pytest.param("mpc", marks=pytest.mark.slow)])
def test_the_self_test_reproduces_the_golden_flight(law, exported, tmp_path):
    if law == "mpc":
        exported = tmp_path
        airpuck.export.write(M4, "c", exported, tuning=predictive())
    golden = (exported / "golden.csv").read_text()
    flying = {"lqr": {"exact", "scaled"}, "mpc": {"optimal", "softened"}}[law]
    assert flying | {"stale pose", "jumping pose", "bad input"} <= {
        line.split(",")[2] for line in golden.splitlines() if line.startswith("step")
    }
    for options in (SANITIZED, SINGLE, ()):
        done = selftest(exported, *options)
        assert done.returncode == 0, done.stdout + done.stderr
        assert re.search(r"state takes [1-9]\d{3,5} bytes", done.stdout)
    # The test notices a difference.
    wrong = golden.replace(*{"lqr": ("scaled", "exact"), "mpc": ("optimal", "softened")}[law], 1)
    (exported / "wrong.csv").write_text(wrong)
    assert selftest(exported, flight="wrong.csv").returncode == 1


@pytest.fixture(scope="module")
def plan() -> Plan:
    """A second of random commands, as if planned: nothing checks that they are the fastest."""
    random, times = np.random.default_rng(2), np.linspace(0.0, 1.0, 21)
    commands = random.uniform(0.1, 0.8, (20, 6))
    start = np.concatenate([[-0.2, 0.1, 0.4, 0.0, 0.0, 0.0], np.full(6, 0.03)])
    states = np.vstack([start, M4.simulate(start, commands, np.diff(times))])
    return Plan(M4, times, states, commands, None)


@pytest.mark.parametrize(
    ("law", "options", "largest"),
    [
        ("lqr", (), 1e-9),
        pytest.param("lqr", SINGLE, 1e-3, marks=pytest.mark.slow),
        pytest.param("mpc", (), 1e-9, marks=pytest.mark.slow),
    ],
)
def test_the_self_test_reproduces_a_planned_flight(law, options, largest, plan, tmp_path):
    tuning = default_tuning() if law == "lqr" else predictive()
    airpuck.export.write(M4, "c", tmp_path, tuning=tuning, plan=plan)
    done = selftest(tmp_path, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    assert float(done.stdout.split()[-1]) < largest


def test_the_program_departs_on_command(plan, tmp_path):
    airpuck.export.write(M4, "c", tmp_path, plan=plan)
    poses = "".join(f"{k / 100:.2f} -0.2 0.1 0.4\n" for k in range(6))
    given = poses + "depart 0.05\n" + "0.06 -0.2 0.1 0.4\n0.07 -0.2 0.1 0.4\n"
    words = [program(tmp_path, "main.c")]
    done = subprocess.run(words, input=given, capture_output=True, text=True, check=True)
    *waiting, _, last = [[float(n) for n in line.split()[2:]] for line in done.stdout.splitlines()]
    assert np.ptp(waiting, axis=0).max() < 0.05
    assert np.abs(np.subtract(last, waiting[-1])).max() > 0.2


@pytest.mark.parametrize("using", ["gcc", "clang"])
def test_no_compiler_warns(exported, using):
    compiler(using)
    for options in ((), ("-DAIRPUCK_SINGLE",)):
        program(exported, "main.c", *options, using=using)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["lqr", "mpc"])
def test_the_sources_compile_as_c_plus_plus(law, tmp_path):
    tuning = predictive() if law == "mpc" else default_tuning()
    airpuck.export.write(M4, "c", tmp_path, tuning=tuning)
    strict = [option for option in STRICT if not option.startswith("-std")]
    words = [compiler("clang"), "-x", "c++", "-std=c++20", *strict, "-c", "-fsyntax-only"]
    for source in tmp_path.glob("airpuck*.c"):
        done = subprocess.run([*words, source], capture_output=True, text=True, check=False)
        assert not done.stderr, done.stderr


def test_no_macro_has_a_short_name(exported):
    """Headers of microcontrollers define many; one letter would collide."""
    defined = re.findall(
        r"#define (\w+)", "\n".join(p.read_text() for p in exported.glob("*.[ch]"))
    )
    assert "AIRPUCK_MOTORS" in defined
    assert not [name for name in defined if len(name) < 3]


def test_a_program_in_c_plus_plus_can_call_the_controller(exported, tmp_path):
    (tmp_path / "main.cpp").write_text(
        '#include "airpuck.h"\nstatic airpuck craft;\n'
        "int main() { airpuck_init(&craft); return airpuck_identified.twin[0]; }\n"
    )
    words = [compiler("clang"), "-std=c++11", "-Wall", "-Wextra", "-Werror", f"-I{exported}", "-c"]
    subprocess.run([*words, tmp_path / "main.cpp", "-o", tmp_path / "main.o"], check=True)
    words = ["nm", "--undefined-only", tmp_path / "main.o"]
    listed = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert " U airpuck_init\n" in listed


@pytest.fixture(scope="module")
def single(tmp_path_factory) -> Path:
    return library(M4, tmp_path_factory.mktemp("single") / "c", "-DAIRPUCK_SINGLE")


def test_single_precision_makes_the_same_decisions(single):
    c = CompiledController(single, M4)
    found = compare(TrackingController(M4, HOME, compiled=False), c, 300)
    assert found.same > 0.99
    assert np.quantile([step.command for step in found.steps], 0.99) < 2e-5


def test_single_precision_allocates_to_opposed_propellers(tmp_path):
    """M3's propellers are exactly opposed: rounding a column would let a pair push in vain."""
    airpuck.export.write(PAPER["M3"], "c", tmp_path)
    done = selftest(tmp_path, *SINGLE)
    assert done.returncode == 0, done.stdout + done.stderr


def test_single_precision_finds_the_nearest_acceleration_of_four_propellers(tmp_path):
    c = CompiledController(library(FOUR, tmp_path / "c", "-DAIRPUCK_SINGLE"), FOUR)
    found = compare(TrackingController(FOUR, HOME, compiled=False), c, 400)
    nearest = [s for s in found.steps if s.statuses == ("nearest", "nearest") and s.state < 1e-3]
    assert len(nearest) >= 5
    assert max(step.command for step in nearest) < 2e-5


@pytest.mark.parametrize("fault", ["poses at nearly the same time", "an absurd command"])
def test_single_precision_recovers_from_extreme_inputs(fault, single):
    c = CompiledController(single, M4)
    c.reference = HOME
    for k in range(400):
        c.pose(0.01 * k, np.zeros(3))
        if k == 50 and fault == "poses at nearly the same time":
            c.pose(0.01 * k + 1e-11, np.zeros(3))
        result = c.step(0.01 * k)
        absurd = k == 50 and fault == "an absurd command"
        c.sent(0.01 * k, np.full(6, 1e30) if absurd else result.command)
    assert result.flies
    assert np.abs(result.estimate.state).max() < 1e-3


def test_the_licences_accompany_the_sources(exported):
    for source in exported.glob("airpuck*.[ch]"):
        generated = source.name in ("airpuck_sizes.h", "airpuck_data.c")
        assert generated or "SPDX-License-Identifier: BSD-2-Clause" in source.read_text()
    ours = (Path(__file__).parents[2] / "LICENSE").read_text()
    assert (exported / "LICENSE").read_text() == ours


def test_nothing_is_allocated_and_no_state_is_static(exported, tmp_path):
    sources = [p for p in exported.glob("airpuck*.c") if "selftest" not in p.name]
    for number, source in enumerate(sources):
        build(tmp_path / f"{number}.o", [source], "-c")
    words = ["nm", *tmp_path.glob("*.o")]
    listed = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-2:] for line in listed.splitlines() if " " in line]
    # Constant pointers to the words for statuses are relocated, and so count as data.
    assert {name for kind, name in symbols if kind in "DdBbC"} <= {"names.0"}
    needed = {name for kind, name in symbols if kind == "U"}
    own = {name for name in needed if name.startswith("airpuck_")}
    others = {name.lstrip("_").removesuffix("_chk") for name in needed - own}
    libm = {"cos", "sin", "exp", "sqrt", "rint", "fabs", "GLOBAL_OFFSET_TABLE_"}
    assert others <= libm | {"memcpy", "memmove", "memset", "stack_fail", "stack_chk_fail"}


def test_the_program_reads_poses_and_writes_commands(exported):
    given = "0 0 0 0\n0.01 0 0 0\ntarget 0.1 0 0\n0.02 0.001 0 0\n"
    words = [program(exported, "main.c")]
    done = subprocess.run(words, input=given, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[:2] for line in lines] == [[f"0.0{k}00", "exact"] for k in range(3)]
    assert all(0.03 <= float(number) <= 1 for line in lines for number in line[2:])
    bad = subprocess.run(words, input="0 0\n", capture_output=True, text=True)
    assert bad.returncode == 1
    assert "time x y yaw" in bad.stderr


@pytest.mark.parametrize("wrong", ["1000", "0.5", "inf", "nan"])
def test_the_program_continues_after_an_invalid_stamp(wrong, exported):
    times = [f"{k / 100:.2f}" for k in range(40)]
    given = "".join(f"{time} 0 0 0\n" for time in [*times[:5], wrong, *times[5:]])
    words = [program(exported, "main.c")]
    done = subprocess.run(words, input=given, capture_output=True, text=True, check=True)
    answers = dict(line.split()[:2] for line in done.stdout.splitlines())
    assert all(answers[f"{time}00"] == "exact" for time in times[:5])
    # Poses that agree for the longest pause are accepted again.
    assert all(answers[f"{time}00"] == "exact" for time in times[-5:])


@pytest.mark.parametrize("law", ["lqr", pytest.param("mpc", marks=pytest.mark.slow)])
def test_without_target_or_plan_the_motors_idle(law, tmp_path):
    airpuck.export.write(M4, "c", tmp_path, tuning=default_tuning().with_law(law))
    (tmp_path / "none.c").write_text(
        '#include "airpuck.h"\n'
        "int main(void)\n{\n    static airpuck craft;\n    airpuck_real command[AIRPUCK_MOTORS];\n"
        "    const airpuck_real pose[3] = {0, 0, 0};\n    airpuck_init(&craft);\n"
        "    airpuck_pose(&craft, 0, pose);\n"
        "    if (airpuck_step(&craft, 0, NULL, command) != AIRPUCK_BAD_INPUT)\n        return 1;\n"
        "    for (int i = 0; i < AIRPUCK_MOTORS; i++)\n"
        "        if (command[i] > airpuck_tuned.command_min)\n            return 2;\n"
        "    return craft.status != AIRPUCK_BAD_INPUT;\n}\n"
    )
    assert (
        subprocess.run([program(tmp_path, "none.c", *SANITIZED)], env=ENVIRONMENT).returncode == 0
    )


@pytest.mark.parametrize("using", ["gcc", "clang"])
@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
def test_compiler_options_that_remove_input_checks_are_an_error(option, using, exported, tmp_path):
    words = [compiler(using), "-std=c99", option, "-c", exported / "airpuck.c"]
    done = subprocess.run([*words, "-o", tmp_path / "a.o"], capture_output=True, text=True)
    assert done.returncode != 0
    assert "-ffinite-math-only: they remove checks of the input" in done.stderr


@pytest.mark.parametrize("name", ["M4", pytest.param("all effects", marks=pytest.mark.slow)])
def test_the_predictive_law_plans_as_in_python(name, tmp_path, monkeypatch):
    model, tuning, bound = MODELS[name], predictive(), []
    solve = Condensed.solve

    def recorded(self, formed):
        answer = solve(self, formed)
        bound.append(None if answer is None else answer.binding)
        return answer

    monkeypatch.setattr(Condensed, "solve", recorded)
    python = TrackingController(model, HOME, tuning, compiled=False)
    c = CompiledController(library(model, tmp_path / "c", tuning=tuning), model, tuning)
    bound.clear()
    sets = []
    found = compare(python, c, 60, after=lambda: sets.append(c.limits()))
    assert found.same == 1
    assert found.worst("command") < 1e-7
    assert found.worst("state") < 1e-9
    assert {"optimal", "softened"} <= set(found.seen)
    solved = [k for k, step in enumerate(found.steps) if step.statuses[0] in PLANNED]
    assert len(solved) == len(bound)
    for k, binding in zip(solved, bound, strict=True):
        assert (sets[k] == binding).all()


def test_features_without_c_code_are_named(tmp_path):
    tuning = default_tuning()
    for model, chosen, name in (
        (M4, tuning.with_estimator("actuation"), "actuation"),
        (M4, tuning.with_law("own.py:Law"), "own.py:Law"),
        (M4, tuning.with_law("plan"), "--plan"),
        (ON_OFF, tuning, "on_off"),
        (scaled(M4, -1.0), tuning, "falls"),
    ):
        with pytest.raises(InputError, match=name):
            airpuck.export.write(model, "c", tmp_path / "none", tuning=chosen)
        assert not (tmp_path / "none").exists()
