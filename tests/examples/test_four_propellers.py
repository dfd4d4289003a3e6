import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import airpuck

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "four_propellers"


def test_raw_bags_become_a_report_page(tmp_path: Path):
    script = EXAMPLE / "run.sh"
    assert len([line for line in script.read_text().splitlines() if line.strip()]) < 15
    paths = [str(Path(sys.executable).parent), os.environ["PATH"]]
    environment = {**os.environ, "PATH": os.pathsep.join(paths), "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(
        ["sh", str(script), str(tmp_path / "out"), "7"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "arrival times" in done.stderr
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    assert page.lower().startswith("<!doctype html>")
    # The truth that make_bags.py flies; the vehicle file believes 0.4 N and 5e-4 kg m².
    model = airpuck.read_model(tmp_path / "out" / "model.toml")
    np.testing.assert_allclose(model.parameters.thrust.sum(axis=1), 0.6, rtol=0.03)
    assert model.parameters.inertia == pytest.approx(6.7e-4, rel=0.03)
    assert model.parameters.motor_time_constant == pytest.approx(0.03, rel=0.1)
