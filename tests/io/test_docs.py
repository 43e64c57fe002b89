"""The examples of docs/files.md run as they stand."""

import re
from pathlib import Path

import numpy as np

from cablejax.io import read_points, write_points

PAGE = Path(__file__).resolve().parents[2] / "docs" / "files.md"


def test_examples_run(tmp_path, monkeypatch, capsys):
    import pye57

    monkeypatch.chdir(tmp_path)
    xyz = np.random.default_rng(0).normal(size=(50, 3))
    with pye57.E57("scan.e57", mode="w") as file:
        file.write_scan_raw({f"cartesian{axis}": column for axis, column in zip("XYZ", xyz.T, strict=True)})
    write_points("plant.laz", xyz * 1000, unit="m")
    Path("export.txt").write_text("".join(f"{i} {x} {y} {z} 7\n" for i, (x, y, z) in enumerate(xyz.tolist())))
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == "50 points, 0 invalid returns left out\n"
    assert len(read_points("scan.laz", unit="m").xyz_mm) == 50
    assert np.abs(read_points("plant.ply", unit="m").xyz_mm - xyz * 1000).max() < 1e-3
