"""Every example runs, in a short version."""

import json
import os
import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

import taichi_dem as dem
from taichi_dem.output import read_history

ROOT = Path(__file__).parents[1]
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
ALONE = {  # those of the half-space, without a simulation
    "attraction.py": ("--steps", 8),
    "thin_layer.py": ("--points", 4),
    "thousand_on_gel.py": ("--count", 60, "--points", 20),
    "two_spheres.py": ("--points", 4),
}
SCENES = sorted((ROOT / "examples").glob("*.toml"))

BEADS = """two beads of hydrogel

2 atoms
1 atom types

0 0.165 xlo xhi
0 0.165 ylo yhi
0 0.168 zlo zhi

Atoms # sphere

1 1 0.018 11.5 0.05 0.05 0.009
2 1 0.018 11.5 0.10 0.05 0.009
"""


def run(*command):
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, *map(str, command)], capture_output=True, text=True, env=env
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def short(script, folder):
    """Arguments with which a script takes seconds, and writes into ``folder``."""
    if script == "bed_on_gel.py":
        return "-o", folder, "--spheres", 40, "--duration", 2e-3
    if script == "hydrogel_piston.py":
        packing = folder.with_suffix(".data")
        packing.write_text(BEADS)
        return packing, "--out", folder, "--duration", 0.01
    if script == "powder_compaction.py":
        return "-o", folder, "--grains", 30, "--duration", 2e-4
    if script == "rolling_to_rest.py":
        return "-o", folder, "--duration", 0.01
    if script in ALONE:
        return "-o", folder, *ALONE[script]
    pytest.fail(f"say how to run a short version of {script}")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_script_runs(script, tmp_path):
    run(script, *short(script.name, tmp_path / "out"))
    assert list((tmp_path / "out").glob("*.png"))
    if script.name in ALONE:
        return
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["outcome"] == "finished"
    assert len(read_history(tmp_path / "out")["time_s"]) > 1


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.name)
def test_scene_runs(scene, tmp_path):
    few = ["--set", "spheres.generate.count=40", "--set", "run.frames=1e-3"]
    out = run("-m", "taichi_dem", "run", scene, "-o", tmp_path / "out", "--duration", 2e-3, *few)
    assert out.count("finished") == 1
    assert read_history(tmp_path / "out")["time_s"][-1] >= 2e-3


def test_the_bed_is_the_same_from_python_and_from_its_file():
    spec = spec_from_file_location("bed_on_gel", ROOT / "examples" / "bed_on_gel.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.bed() == dem.Scene.from_toml(ROOT / "examples" / "bed_on_gel.toml")


def readme(language):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_python_in_the_readme_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    names = {}
    for block in readme("python"):
        exec(block, names)
    assert names["sim"].time >= 0.05
    assert names["slope"].shape == (2, 2)


def test_scene_in_the_readme_is_right(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(readme("toml")[0])
    assert dem.Scene.from_toml(path).spheres.count == 400
