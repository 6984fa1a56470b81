"""The adapter that docs/guides/lab.md shows: what it records is read by the program and by Python."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from hw.reader import Reader
from tests.support import program
from tests.support.paths import EXAMPLES, SCENE


def test_adapter_records_what_read_reads(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", str(EXAMPLES / "daq_adapter.py"), "run.probe"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)
    assert (ended.returncode, ended.stdout) == (0, "2000 samples, 0 gaps\n"), ended.stderr
    with Reader.open(f"replay:{tmp_path / 'run.probe'}") as reader:
        amplitudes = np.sqrt(2) * np.std(reader.collect().volts, axis=0)
    np.testing.assert_allclose(amplitudes, [8e-5, 12e-5], rtol=1e-3)
    ended = program.run("read", SCENE, "--replay", tmp_path / "run.probe", "--json")
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    # charges are as 2 to 3, and A2/A1 = 1.2 in the scene
    assert abs(output["ratio"] - 2 / 3 / 1.2) < 1e-3
