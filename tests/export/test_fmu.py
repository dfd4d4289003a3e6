"""The FMI unit: described as the standard says, equal to the twin, and safe from any caller."""

import os
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy import platform_tuple, read_model_description, sharedLibraryExtension, simulate_fmu
from fmpy.build import build_platform_binary
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from airpuck import InputError, Model, Table, Twin, TwinSettings
from airpuck.export import write
from airpuck.model.model_file import published_model
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Effects, OnBoard, default_twin_settings

from ..apparatus.c_programs import SANITIZED, STRICT, build, compiler
from ..apparatus.changes import changed
from ..apparatus.export_crafts import FOUR

ABUSE = Path(__file__).parent / "abuse_fmu.c"
#: The standard's headers, which whoever compiles a unit provides.
HEADERS = Path(fmpy.__file__).parent / "c-code"
MODEL = replace(published_model("M3"), frame="body")
PERIOD = 0.01
#: At regular intervals a camera frame coincides with a communication point.
COMMON = 5


def settings(**more: object) -> TwinSettings:
    """A small table without noise, so that the craft often meets a rail."""
    quiet = changed(
        default_twin_settings(),
        table=Table(length_m=0.2, width_m=0.18),
        radio={"jitter_s": 0.0},
        motion_capture={"position_noise_m": 0.0, "yaw_noise_rad": 0.0, "latency_jitter_s": 0.0},
        on_board=OnBoard(rate_hz=0.0),
    )
    return changed(quiet, **more)


def compiled(unit: Path) -> None:
    """Build an unpacked unit by its own build description, with gcc."""
    description = ElementTree.parse(unit / "sources/buildDescription.xml")
    names = [source.attrib["name"] for source in description.iter("SourceFile")]
    libraries = [f"-l{library.attrib['name']}" for library in description.iter("Library")]
    target = unit / "binaries" / platform_tuple / f"airpuck{sharedLibraryExtension}"
    target.parent.mkdir(parents=True)
    options = ["-fPIC", "-shared", "-O1", f"-I{HEADERS}"]
    command = [compiler("gcc"), *STRICT, *options, *names, "-o", target]
    subprocess.run([*command, *libraries], cwd=unit / "sources", check=True)


def exported(folder: Path, model: Model, twin: TwinSettings) -> Path:
    """Write, unpack and build a unit."""
    write(model, "fmu", folder, twin=twin)
    with zipfile.ZipFile(folder / "airpuck.fmu") as archive:
        archive.extractall(folder / "unit")
    compiled(folder / "unit")
    return folder / "unit"


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("fmu"), MODEL, settings())


class Simulation:
    """An instance of a unit; variables by name."""

    def __init__(self, folder: Path, **parameters: float) -> None:
        described = read_model_description(str(folder))
        self._variables = {v.name: v for v in described.modelVariables}
        self._slave = FMU3Slave(
            instanceName="craft",
            guid=described.instantiationToken,
            unzipDirectory=str(folder),
            modelIdentifier="airpuck",
        )
        self._slave.instantiate()
        self.time = 0.0
        self.start(**parameters)

    def start(self, **parameters: float) -> None:
        self.set(**parameters)
        self._slave.enterInitializationMode()
        self._slave.exitInitializationMode()
        self.time = 0.0

    def set(self, **values: float) -> None:
        for name, value in values.items():
            variable = self._variables[name]
            put = self._slave.setInt32 if variable.type == "Int32" else self._slave.setFloat64
            put([variable.valueReference], [value])

    def get(self, prefix: str) -> np.ndarray:
        """Values of all variables whose names begin so."""
        found = [v for name, v in self._variables.items() if name.startswith(prefix)]
        read = {"Int32": self._slave.getInt32, "Float64": self._slave.getFloat64}
        return np.array([read[v.type]([v.valueReference])[0] for v in found])

    def command(self, command: np.ndarray) -> None:
        names = [v for v in self._variables.values() if v.causality == "input"]
        self._slave.setFloat64([v.valueReference for v in names], list(command))

    def step(self, until: float) -> None:
        self._slave.doStep(self.time, until - self.time)
        self.time = until

    @property
    def state(self) -> np.ndarray:
        return np.concatenate([self.get("state."), self.get("speed.")])


def commands(n: int, count: int, held: int = 10) -> np.ndarray:
    """Random commands that are each held for some periods."""
    random = np.random.default_rng(3)
    return np.repeat(random.random((count // held, n)), held, axis=0)


def test_the_model_description_is_valid(unit: Path) -> None:
    assert validate_fmu(str(unit.parent / "airpuck.fmu")) == []
    described = read_model_description(str(unit))
    assert described.fmiVersion == "3.0" and described.coSimulation.canGetAndSetFMUstate
    by_name = {v.name: v for v in described.modelVariables}
    delay = MODEL.transport_delay
    assert float(by_name["radio.delay"].start) == delay and by_name["radio.delay"].unit == "s"
    inputs = [v.name for v in described.modelVariables if v.causality == "input"]
    assert inputs == [f"command.{name}" for name in MODEL.vehicle.propeller_names]


def test_every_function_of_the_standard_is_exported(unit: Path) -> None:
    headers = (HEADERS / "fmi3Functions.h").read_text()
    declared = {
        line.split()[-1].rstrip(";")
        for line in headers.splitlines()
        if line.startswith("FMI3_Export fmi3")
    }
    library = unit / "binaries" / platform_tuple / f"airpuck{sharedLibraryExtension}"
    symbols = subprocess.run(
        ["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True
    )
    assert len(declared) > 70
    assert declared <= {line.split()[-1] for line in symbols.stdout.splitlines()}


def test_headers_of_the_standard_are_left_to_the_importing_tool(unit: Path) -> None:
    """FMI 3.0 excludes them from a unit, so that the tool's own ones check the functions."""
    assert not list(unit.rglob("fmi3*"))
    used = {h for path in (unit / "sources").glob("*.c") for h in included(path)}
    assert "fmi3Functions.h" in used
    for header in used - {"fmi3Functions.h"}:
        assert (unit / "sources" / header).is_file(), header


def included(source: Path) -> list[str]:
    """Headers in quotes that a source includes."""
    return re.findall(r'^#include "(.+)"$', source.read_text(), re.MULTILINE)


def fly_both(model: Model, twin: TwinSettings, there: Simulation) -> None:
    """A second of random commands in the twin and in the unit, with contacts."""
    flown = Twin(model, twin, plant=build_plant(model, twin, compiled=False))
    arrived = flown.wait_until(0.0)
    for k, command in enumerate(commands(model.vehicle.n_propellers, 100)):
        flown.send(command)
        there.command(command)
        time = (k + 1) * PERIOD
        arrived += flown.wait_until(time)
        there.step(time)
        if (k + 1) % COMMON == 0:
            np.testing.assert_allclose(there.state, flown.state, atol=1e-9, rtol=0)
        *pose, stamp, count = there.get("pose.")
        assert count == len(arrived)
        if arrived:
            assert stamp == pytest.approx(arrived[-1].stamp, abs=1e-9)
            np.testing.assert_allclose(pose, arrived[-1].values, atol=1e-9, rtol=0)
    *last, count = there.get("contact.")
    assert count == len(flown.contacts) > 3
    np.testing.assert_allclose(last, flown.craft.contacts[-1], atol=1e-9, rtol=0)


def test_the_flight_equals_the_twins(unit: Path) -> None:
    """With the model's delay and lag."""
    fly_both(MODEL, settings(), Simulation(unit))


def test_parameters_act_like_the_twins_settings(unit: Path) -> None:
    table = Table(length_m=0.22, width_m=0.19, restitution=0.9, friction=0.5)
    camera, radio = {"rate_hz": 60.0, "latency_s": 0.03}, {"delay_s": 0.0}
    prompt = replace(MODEL, parameters=replace(MODEL.parameters, motor_time_constant=0.0))
    parameters = {
        "motor.time_constant": 0.0,
        "radio.delay": 0.0,
        "camera.rate": 60.0,
        "camera.latency": 0.03,
        "table.length": 0.22,
        "table.width": 0.19,
        "table.restitution": 0.9,
        "table.friction": 0.5,
    }
    twin = settings(table=table, motion_capture=camera, radio=radio)
    fly_both(prompt, twin, Simulation(unit, **parameters))


@pytest.mark.slow
def test_four_propellers_with_effects_fly_as_in_the_twin(tmp_path: Path) -> None:
    """The centre of mass is far enough off that Newton's law of restitution adds energy."""
    model = replace(
        FOUR, parameters=replace(FOUR.parameters, center_of_mass=np.array([0.02, -0.03]))
    )
    effects = Effects(drag_linear_1_s=0.4, inflow_s_m=0.1, tilt_rad=(0.01, -0.02))
    table = Table(length_m=0.17, width_m=0.17, restitution=1.0, friction=0.5)
    twin = settings(effects=effects, table=table)
    fly_both(model, twin, Simulation(exported(tmp_path, model, twin)))


def test_the_motion_does_not_depend_on_the_step_size(unit: Path) -> None:
    """However often the unit is asked, and also after it went back to a former state."""
    coarse, fine = Simulation(unit), Simulation(unit)
    random = np.random.default_rng(0)
    for k, command in enumerate(commands(6, 100)[::10]):
        coarse.command(command)
        fine.command(command)
        end = 0.1 * (k + 1)
        coarse.step(end)
        for time in np.sort(random.uniform(fine.time, end, 5)):
            fine.step(time)
            kept = fine._slave.getFMUState()
            fine.step((time + end) / 2)
            fine._slave.setFMUState(kept)
            fine._slave.freeFMUState(kept)
            fine.time = time
        fine.step(end)
        np.testing.assert_allclose(fine.state, coarse.state, atol=1e-12, rtol=0)
    assert list(fine.get("contact.")) == list(coarse.get("contact."))


def test_reset_restarts_the_same_flight(unit: Path) -> None:
    noise = {"camera.yaw_noise": 1e-3}
    flight = Simulation(unit, **noise, seed=7)
    poses = []
    for _ in range(2):
        flight.command(np.full(6, 0.3))
        flight.step(0.5)
        poses.append(flight.get("pose."))
        flight._slave.reset()
        flight.start(**noise, seed=7)
    assert list(poses[0]) == list(poses[1])
    other = Simulation(unit, **noise, seed=8)
    other.command(np.full(6, 0.3))
    other.step(0.5)
    assert other.get("pose.")[2] != poses[0][2]


def test_noise_and_losses_are_as_stated(unit: Path) -> None:
    """At rest: the spread of 4800 poses, and how many of them arrive."""
    parameters = {
        "camera.position_noise": 2e-3,
        "camera.yaw_noise": 5e-3,
        "camera.dropped": 0.25,
        "start.yaw": 3.14,
    }
    quiet = Simulation(unit, **parameters)
    poses = []
    for k in range(4800):
        quiet.step((k + 1) / 240)
        poses.append(quiet.get("pose."))
    x, y, yaw, _, count = np.array(poses).T
    turned = (yaw - 3.14 + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(yaw).max() <= np.pi
    new = np.diff(count, prepend=0) > 0
    for values, spread in ((x, 2e-3), (y, 2e-3), (turned, 5e-3)):
        assert np.std(values[new]) == pytest.approx(spread, rel=0.08)
        assert abs(values[new].mean()) < 4 * spread / np.sqrt(new.sum())
    assert count[-1] == pytest.approx(0.75 * 4800, rel=0.03)


def test_command_delays_are_as_stated(unit: Path) -> None:
    """Arrivals follow from the speed of a motor with a long lag."""
    lag, period, count = 10.0, 0.2, 2000
    parameters = {"radio.delay": 0.03, "radio.jitter": 0.007, "radio.loss": 0.1}
    flight = Simulation(unit, **parameters, **{"motor.time_constant": lag})
    followed, before, delays = 0.0, 0.0, []
    for k in range(count):
        wanted = 1.0 - followed
        flight.command(np.full(6, wanted))
        flight.step((k + 1) * period)
        speed = flight.get("speed.")[0]
        # After the arrival the motor follows the new command, until then the former one.
        kept = (before - followed) * np.exp(-period / lag)
        left = -lag * np.log((speed - wanted - kept) / (followed - wanted))
        before = speed
        if left > 1e-6:
            delays.append(period - left)
            followed = wanted
    assert len(delays) == pytest.approx(0.9 * count, rel=0.03)
    assert np.mean(delays) == pytest.approx(0.03, abs=6e-4)
    assert np.std(delays) == pytest.approx(0.007, rel=0.07)


def test_commands_do_not_overtake_each_other(unit: Path) -> None:
    """Motors without lag show the command that they follow: here, when it was sent."""
    parameters = {"radio.delay": 0.05, "radio.jitter": 0.03, "motor.time_constant": 0.0}
    flight, followed = Simulation(unit, **parameters), []
    for k in range(500):
        flight.command(np.full(6, k / 500))
        flight.step((k + 1) * PERIOD)
        followed.append(flight.get("speed.")[0])
    assert (np.diff(followed) >= 0).all() and len(set(followed)) > 100


@pytest.mark.slow
def test_no_sequence_of_calls_causes_a_crash(unit: Path, tmp_path: Path) -> None:
    sources = [*(unit / "sources").glob("*.c"), ABUSE]
    program = build(tmp_path / "abuse", sources, *SANITIZED, f"-I{HEADERS}")
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_clang_compiles_the_sources_without_warnings(unit: Path, tmp_path: Path) -> None:
    sources = [*(unit / "sources").glob("*.c"), ABUSE]
    build(tmp_path / "abuse", sources, f"-I{HEADERS}", using="clang")


@pytest.mark.slow
def test_fmpy_builds_and_simulates_the_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With CMake, as fmpy does for any unit; inputs by name."""
    # CMake comes with fmpy.
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    write(MODEL, "fmu", tmp_path)
    with zipfile.ZipFile(tmp_path / "airpuck.fmu") as archive:
        archive.extractall(tmp_path / "unit")
    build_platform_binary(tmp_path / "unit")
    first, *_ = MODEL.vehicle.propeller_names
    given = np.array([(0.0, 0.0), (0.5, 1.0)], dtype=[("time", float), (f"command.{first}", float)])
    found = simulate_fmu(
        str(tmp_path / "unit"),
        stop_time=1.0,
        output_interval=0.1,
        input=given,
        output=["state.x", "state.yaw", "pose.yaw"],
    )
    assert found["time"][-1] == 1.0 and abs(found["state.yaw"][-1]) > 0.1
    late = found["pose.yaw"][-1] - found["state.yaw"][-1]
    assert np.cos(late) > 0.9


@pytest.mark.parametrize(
    ("update", "named"),
    [
        ({"radio": {"outages_s": ((1.0, 2.0),)}}, "radio.outages_s"),
        ({"motion_capture": {"gaps_s": ((1.0, 2.0),)}}, "motion_capture.gaps_s"),
        ({"motion_capture": {"clock_drift": 1e-4}}, "motion_capture.clock_drift"),
        ({"effects": {"battery_sag_1_s": 0.01}}, "effects.battery_sag_1_s"),
        ({"motors": {"unarmed_s": 1.0}}, "motors"),
        ({"motion_capture": {"rate_hz": 1e6}}, "camera.rate"),
    ],
)
def test_unrepresentable_settings_are_rejected(update: dict, named: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=named):
        write(MODEL, "fmu", tmp_path / "out", twin=settings(**update))
    assert not (tmp_path / "out").exists()


def test_unrepresentable_craft_are_rejected(tmp_path: Path) -> None:
    unprintable = FOUR.vehicle.model_copy(update={"name": "\1<&\"', é"})
    write(replace(FOUR, vehicle=unprintable), "fmu", tmp_path)
    assert validate_fmu(str(tmp_path / "airpuck.fmu")) == []
    twice = replace(MODEL, parameters=replace(MODEL.parameters, inflow=0.1))
    with pytest.raises(InputError, match="Inflow"):
        write(twice, "fmu", tmp_path, twin=settings(effects=Effects(inflow_s_m=0.1)))
