"""Impacts of two spheres in scenes against LIGGGHTS 3.8 and LAMMPS, step by step."""

import shutil
import subprocess

import numpy as np
import pytest
from setups import scene, watch
from test_eepa_peer import DENSITY, MODULUS, POISSON, RADII
from test_eepa_peer import liggghts as eepa_in_liggghts

import taichi_dem as dem

pytestmark = pytest.mark.peers
GRAIN = dem.Material("grain", DENSITY, MODULUS, POISSON)
SPEED, STEPS = 0.2, 2500


def needs(program):
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"needs the {program} binary")


def ours(law, dt, steps=STEPS, speed=SPEED, omega=0.0):
    """Two spheres that just touch and close at ``speed`` along x: (steps + 1, 2, 6) positions and
    angular velocities."""
    setup = scene(
        [(0, 0, 0), (sum(RADII), 0, 0)],
        RADII,
        GRAIN,
        [(speed / 2, 0, 0), (-speed / 2, 0, 0)],
        omega,
        law=law,
    )
    sim = dem.Simulation(setup, dt, driver="serial")
    return watch(
        sim, steps, 1, lambda sim: np.hstack([sim.particles.position, sim.particles.omega])
    )


@needs("liggghts")
@pytest.mark.filterwarnings("ignore:dt")
@pytest.mark.parametrize(
    ("kappa", "energy", "pull_off", "n"),
    [(2.0, 0.0, 0.0, 1.5), (5.0, 20.0, 0.0, 1.5), (20.0, 20.0, -0.01, 1.0)],
)
def test_eepa_equals_liggghts(tmp_path, kappa, energy, pull_off, n):
    case = {
        "n": n,
        "c": 1.0,
        "kappa": kappa,
        "energy": energy,
        "pull_off": pull_off,
        "speed": SPEED,
        "restitution": 0.7,
        "dt": 5e-7,
        "steps": STEPS,
    }
    limit = not energy and not pull_off
    law = dem.EEPA(0.7, kappa, n, 1.0, energy, pull_off, "constant", limit)
    found = ours(dem.Law(law), case["dt"])[:, :, 0]
    assert np.abs(found - eepa_in_liggghts(tmp_path, case)).max() < 1e-12 * min(RADII)


CDT = """\
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
region all block -1 1 -1 1 -1 1 units box
create_box 1 all
neighbor 0.002 bin
neigh_modify delay 0
soft_particles yes
hard_particles yes
fix a all property/global youngsModulus peratomtype {modulus!r}
fix b all property/global poissonsRatio peratomtype {poisson!r}
fix c all property/global coefficientRestitution peratomtypepair 1 0.7
fix d all property/global coefficientFriction peratomtypepair 1 0.0
fix e all property/global coefficientRollingFriction peratomtypepair 1 0.1
pair_style gran model hertz tangential history rolling_friction cdt
pair_coeff * *
timestep {dt!r}
fix move all nve/sphere
create_atoms 1 single 0 0 0
create_atoms 1 single {distance!r} 0 0
set atom 1 diameter {first!r} density {density!r} vx {half!r}
set atom 2 diameter {second!r} density {density!r} vx {back!r}
velocity all set 0 0 0 sum yes
set atom 1 omegay 30 omegaz -10
set atom 2 omegay 5 omegaz 20
dump out all custom 1 positions id x omegay omegaz
dump_modify out sort id format "%d %.17g %.17g %.17g"
run {steps}
"""


def rows(path):
    """(steps, 2, columns) of a dump of two atoms, the ids left out."""
    blocks = path.read_text().split("ITEM: ATOMS")[1:]
    lines = [[line.split()[1:] for line in block.splitlines()[1:3]] for block in blocks]
    return np.array(lines, dtype=float)


@needs("liggghts")
@pytest.mark.filterwarnings("ignore:dt")
def test_cdt_equals_liggghts(tmp_path):
    """Without friction nothing but the rolling law turns the spheres."""
    dt, speed = 5e-7, SPEED
    numbers = {
        "modulus": MODULUS,
        "poisson": POISSON,
        "dt": dt,
        "distance": sum(RADII),
        "first": 2 * RADII[0],
        "second": 2 * RADII[1],
        "density": DENSITY,
        "half": speed / 2,
        "back": -speed / 2,
        "steps": STEPS,
    }
    (tmp_path / "in.roll").write_text(CDT.format(**numbers))
    command = ["liggghts", "-in", "in.roll", "-screen", "none"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    theirs = rows(tmp_path / "positions")
    law = dem.Law(dem.Hertz(0.7), rolling=dem.CDT(0.1))
    found = ours(law, dt, omega=[(0, 30, -10), (0, 5, 20)])
    assert np.abs(found[:, :, 0] - theirs[:, :, 0]).max() < 1e-12 * min(RADII)
    assert np.abs(found[:, :, 4:] - theirs[:, :, 1:]).max() < 1e-9 * 30
    assert np.abs(np.diff(theirs[:, 0, 1])).max() > 0


JKR = """\
units si
atom_style sphere
atom_modify map array
boundary f f f
newton off
region all block -0.1 0.1 -0.1 0.1 -0.1 0.1 units box
create_box 1 all
neighbor 0.002 bin
neigh_modify delay 0 every 1 check yes
comm_modify vel yes
pair_style granular
pair_coeff * * jkr {modulus!r} 0.0 {poisson!r} {surface!r} tangential linear_history 1.0 0.0 0.0 &
 damping velocity
timestep {dt!r}
fix move all nve/sphere
create_atoms 1 single 0 0 0
create_atoms 1 single {distance!r} 0 0
set atom 1 diameter {first!r} density {density!r} vx {half!r}
set atom 2 diameter {second!r} density {density!r} vx {back!r}
dump out all custom 1 positions id x
dump_modify out sort id format line "%d %.17g"
run {steps}
"""


@needs("lmp")
@pytest.mark.filterwarnings("ignore:dt")
def test_jkr_equals_lammps(tmp_path):
    """Up to the largest pull, where LAMMPS opens a contact."""
    dt, steps, work = 5e-7, 2500, 0.5
    distance = sum(RADII) * (1 - 1e-6)
    numbers = {
        "modulus": MODULUS,
        "poisson": POISSON,
        "surface": work / 2,  # of each of the two surfaces
        "dt": dt,
        "distance": distance,
        "first": 2 * RADII[0],
        "second": 2 * RADII[1],
        "density": DENSITY,
        "half": SPEED / 2,
        "back": -SPEED / 2,
        "steps": steps,
    }
    (tmp_path / "in.impact").write_text(JKR.format(**numbers))
    command = ["lmp", "-in", "in.impact", "-screen", "none"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    theirs = rows(tmp_path / "positions")[:, :, 0]
    setup = scene(
        [(0, 0, 0), (distance, 0, 0)],
        RADII,
        GRAIN,
        [(SPEED / 2, 0, 0), (-SPEED / 2, 0, 0)],
        law=dem.Law(dem.JKR(work, 1.0)),
    )
    sim = dem.Simulation(setup, dt, driver="serial")
    found = watch(sim, steps, 1, lambda sim: sim.particles.position[:, 0])
    overlap = sum(RADII) - np.diff(found, axis=1)[:, 0]
    deepest = int(np.argmax(overlap))
    apart = deepest + int(np.argmax(overlap[deepest:] < 0))
    assert overlap.max() > 1e-3 * min(RADII) and apart > deepest > 0
    assert np.abs(found - theirs)[:apart].max() < 1e-9 * min(RADII)
