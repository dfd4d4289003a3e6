import runpy
from pathlib import Path

import numpy as np
import pytest

TABLE = Path(__file__).parents[2] / "examples/air_bearing_satellite/table.py"


def test_load_cell_force_is_the_settled_weight_minus_the_weight_before(tmp_path: Path):
    folder = tmp_path / "Thruster_Test/Thruster_Data"
    folder.mkdir(parents=True)
    rows = ["t_s,weight_g,bitmask,pulse_number,phase", "0.0,,0,0,baseline"]
    for pulse, grams in ((1, 50.0), (2, 52.0)):
        start = 20 * pulse
        rows += [f"{start + t:.2f},2.0,0,{pulse},pre_pulse" for t in np.arange(0, 0.5, 0.1)]
        for t in np.arange(0, 10, 0.1):
            weight = 2 + grams * (1 - np.exp(-t / 0.3))  # a scale that is slow
            rows.append(f"{start + 1 + t:.2f},{weight:.3f},4,{pulse},firing")
        rows += [f"{start + 11 + t:.2f},9.0,0,{pulse},post_pulse" for t in np.arange(0, 1, 0.1)]
    (folder / "test.csv").write_text("\n".join(rows) + "\n")
    found = runpy.run_path(str(TABLE))["load_cell"](tmp_path)
    ((thruster, (force, scatter)),) = found.items()
    assert thruster == 3
    assert force == pytest.approx(0.051 * 9.81, abs=1e-4)
    assert scatter == pytest.approx(0.001 * 9.81, abs=1e-4)
