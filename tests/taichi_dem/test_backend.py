"""Both compilers and both precisions run the same scene; the two compilers to the same bits."""

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest

SCENE = """
import sys
import numpy as np
import taichi_dem as dem

gel = dem.Material("gel", density=1050, youngs_modulus=2e5, poissons_ratio=0.49)
glass = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
x = np.array([[0, 0, 1.05e-3], [2.05e-3, 0, 1.0e-3], [1e-3, 0.2e-3, 2.8e-3]])
scene = dem.Scene(
    spheres=dem.Spheres(position=x, radius=1e-3, material=glass, velocity=(0.05, 0, -0.1)),
    substrate=dem.Substrate(material=gel),
    law=dem.Law(normal=dem.Hertz(restitution=0.6), tangential=dem.Mindlin(friction=0.3)),
)
sim = dem.Simulation(scene)
sim.run(steps=2000)
assert len(sim.contacts()) > 0
np.savez(sys.argv[1], position=sim.particles.position, omega=sim.particles.omega)
"""


def run(folder, **environment):
    path = folder / ("-".join(environment.values()) + ".npz")
    command = [sys.executable, "-c", SCENE, str(path)]
    done = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""  # the compiler's banner stays out of the user's terminal
    return np.load(path)


@pytest.fixture(scope="module")
def double(tmp_path_factory):
    return run(tmp_path_factory.mktemp("double"), HALFSPACE_PRECISION="double")


@pytest.mark.skipif(
    importlib.util.find_spec("quadrants") is None, reason="the package quadrants is not installed"
)
def test_quadrants_gives_the_same_bits(double, tmp_path):
    other = run(tmp_path, HALFSPACE_BACKEND="quadrants")
    for name in ("position", "omega"):
        assert np.array_equal(other[name], double[name])


def test_single_precision_follows_double(double, tmp_path):
    single = run(tmp_path, HALFSPACE_PRECISION="single")
    assert np.abs(single["position"] - double["position"]).max() < 1e-3 * 1e-3  # of a radius
    assert not np.array_equal(single["position"], double["position"])


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no process keeps to some cores")
def test_there_are_as_many_threads_as_cores_to_use():
    """One beside another on one core would only wait for it."""
    code = """
import os
allowed = sorted(os.sched_getaffinity(0))
os.sched_setaffinity(0, allowed[:{cores}])
from halfspace import backend
print(backend.THREADS)
"""
    environment = {name: value for name, value in os.environ.items() if name != "HALFSPACE_THREADS"}
    for cores in (1, len(os.sched_getaffinity(0))):
        done = subprocess.run(
            [sys.executable, "-c", code.format(cores=cores)],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert int(done.stdout) == cores


@pytest.mark.parametrize(
    ("variable", "value", "right"),
    [
        ("HALFSPACE_BACKEND", "numba", "taichi, quadrants"),
        ("HALFSPACE_PRECISION", "half", "double, single"),
        ("HALFSPACE_THREADS", "none", "a whole number >= 1"),
    ],
)
def test_a_wrong_choice_is_refused(variable, value, right):
    done = subprocess.run(
        [sys.executable, "-c", "import halfspace.backend"],
        env={**os.environ, variable: value},
        capture_output=True,
        text=True,
        check=False,
    )
    assert f"{variable} = {value}: must be" in done.stderr
    assert right in done.stderr
