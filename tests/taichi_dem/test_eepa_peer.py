"""EEPA against LIGGGHTS 3.8: head-on impacts of two spheres, step by step."""

import shutil
import subprocess

import numpy as np
import pytest
from law_twins import EEPA

pytestmark = [
    pytest.mark.peers,
    pytest.mark.skipif(shutil.which("liggghts") is None, reason="needs the liggghts binary"),
]

RADII, DENSITY, MODULUS, POISSON = (5e-3, 4e-3), 2500.0, 1e7, 0.3

SCRIPT = """\
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
{properties}
pair_style gran model edinburgh tangential history
pair_coeff * *
timestep {dt!r}
fix move all nve/sphere
create_atoms 1 single 0 0 0
create_atoms 1 single {distance!r} 0 0
set atom 1 diameter {first!r} density {density!r} vx {half!r}
set atom 2 diameter {second!r} density {density!r} vx {back!r}
dump out all custom 1 positions id x
dump_modify out sort id format "%d %.17g"
run {steps}
"""


def liggghts(folder, case):
    """Positions of both spheres after each step, (steps + 1, 2)."""
    pair = "peratomtypepair 1"
    values = {
        "youngsModulus": f"peratomtype {MODULUS!r}",
        "poissonsRatio": f"peratomtype {POISSON!r}",
        "coefficientRestitution": f"{pair} {case['restitution']!r}",
        "coefficientFriction": f"{pair} 0.0",
        "coefficientAdhesionStiffness": f"{pair} 1.0",
        "UnloadingStiffness": f"{pair} {case['kappa']!r}",
        "adhesionExponent": f"scalar {case['c']!r}",
        "overlapExponent": f"scalar {case['n']!r}",
        "pullOffForce": f"{pair} {case['pull_off']!r}",
        "surfaceEnergy": f"{pair} {case['energy']!r}",
    }
    properties = (f"fix {k} all property/global {k} {value}" for k, value in values.items())
    script = SCRIPT.format(
        properties="\n".join(properties),
        dt=case["dt"],
        distance=sum(RADII),
        first=2 * RADII[0],
        second=2 * RADII[1],
        density=DENSITY,
        half=case["speed"] / 2,
        back=-case["speed"] / 2,
        steps=case["steps"],
    )
    (folder / "in.impact").write_text(script)
    command = ["liggghts", "-in", "in.impact", "-screen", "none"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    blocks = (folder / "positions").read_text().split("ITEM: ATOMS")[1:]
    rows = [[float(line.split()[1]) for line in block.splitlines()[1:3]] for block in blocks]
    return np.array(rows)


def twin(case):
    """The same by velocity Verlet, whose dashpots see the velocity of the half step."""

    def one(value):
        return np.array([float(value)])

    mass = [DENSITY * 4 / 3 * np.pi * radius**3 for radius in RADII]
    law = EEPA(
        modulus=one(MODULUS / (2 * (1 - POISSON**2))),
        restitution=one(case["restitution"]),
        stiffness_ratio=one(case["kappa"]),
        surface_energy=one(case["energy"]),
        pull_off=one(case["pull_off"]),
        radius_i=one(RADII[0]),
        radius_j=one(RADII[1]),
        mass=one(mass[0] * mass[1] / sum(mass)),
        overlap_exponent=case["n"],
        adhesion_exponent=case["c"],
        damping="constant",
        limit_force=not case["energy"] and not case["pull_off"],  # as LIGGGHTS does
    )
    position, velocity = np.array([0, sum(RADII)]), np.array([0.5, -0.5]) * case["speed"]
    share, dt = np.array([-1, 1]) / np.array(mass), case["dt"]
    plastic = start = one(0)
    force, path = 0.0, [position]
    for _ in range(case["steps"]):
        velocity = velocity + dt / 2 * force * share
        position = position + dt * velocity
        overlap, force = one(sum(RADII) - (position[1] - position[0])), 0.0
        if overlap[0] > 0:
            elastic, plastic, start = law.step(overlap, plastic, start)
            drag = law.drag(overlap) * (velocity[1] - velocity[0])
            force = (elastic + law.pull_off - drag)[0]
            force = max(force, 0.0) if law.limit_force else force
        else:
            plastic = start = one(0)
        velocity = velocity + dt / 2 * force * share
        path.append(position)
    return np.array(path)


@pytest.mark.parametrize("n", [1.0, 1.5])
@pytest.mark.parametrize("c", [1.0, 1.5, 3.0])
@pytest.mark.parametrize(
    ("kappa", "energy", "pull_off", "speed", "restitution"),
    [
        (2.0, 0.0, 0.0, 0.5, 0.7),  # rebounds
        (5.0, 20.0, 0.0, 0.2, 0.9),  # slides down the adhesive branch and parts
        (20.0, 20.0, -0.01, 0.2, 0.7),  # turns on the adhesive branch and reloads
        (2.0, 20.0, -0.05, 0.2, 0.2),
        (10.0, 300.0, -0.001, 0.05, 0.9),  # the pull at its limit; sticks and swings
    ],
)
def test_impacts_equal_those_of_liggghts(
    tmp_path, n, c, kappa, energy, pull_off, speed, restitution
):
    """Through yielding, sticking, reloading and parting, positions to 1e-12 of the radius."""
    case = {
        "n": n,
        "c": c,
        "kappa": kappa,
        "energy": energy,
        "pull_off": pull_off,
        "speed": speed,
        "restitution": restitution,
        "dt": 2e-7 if n == 1 else 5e-7,
        "steps": 2500,
    }
    error = np.abs(twin(case) - liggghts(tmp_path, case)).max()
    assert error < 1e-12 * min(RADII)
