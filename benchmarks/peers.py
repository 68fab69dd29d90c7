"""The settled bed in the input languages of LIGGGHTS and LAMMPS, and what their logs say of it.

Both read the same data file (atom style ``granular`` and ``sphere`` have the same columns) and take
the same laws: Hertz, a Mindlin spring with history, Coulomb friction, and the dashpot of Tsuji et
al. that gives a constant restitution.
"""

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import bed as beds
from bed import Bed

COMMANDS = {"liggghts": "liggghts", "lammps": "lmp"}

COMMON = """\
units si
boundary f f f
newton off
processors * * *
read_data bed.data
neighbor {skin} bin
neigh_modify delay 0 every 1 check yes
timestep {dt}
"""

LIGGGHTS = (
    "atom_style granular\natom_modify map array\ncommunicate single vel yes\n"
    + COMMON
    + """\
fix m1 all property/global youngsModulus peratomtype {young}
fix m2 all property/global poissonsRatio peratomtype {poisson}
fix m3 all property/global coefficientRestitution peratomtypepair 1 {restitution}
fix m4 all property/global coefficientFriction peratomtypepair 1 {friction}
pair_style gran model hertz tangential history
pair_coeff * *
fix g all gravity {gravity} vector 0 0 -1
{walls}
fix move all nve/sphere
compute touching all contact/atom
"""
)
LIGGGHTS_WALL = (
    "fix w{k} all wall/gran model hertz tangential history primitive type 1 {axis}plane {place}"
)

LAMMPS = (
    "atom_style sphere\ncomm_modify vel yes\n"
    + COMMON
    + """\
pair_style granular
pair_coeff * * {model}
fix g all gravity {gravity} vector 0 0 -1
{walls}
fix move all nve/sphere
compute touching all contact/atom
"""
)
LAMMPS_MODEL = (
    "hertz/material {young} {restitution} {poisson} damping tsuji "
    "tangential mindlin NULL 1.0 {friction}"
)
LAMMPS_WALL = "fix w{k} all wall/gran granular {model} {axis}plane {low} {high}"

RUN = """\
compute total all reduce sum c_touching
compute turning all erotate/sphere
thermo_style custom step atoms ke c_total c_turning
thermo_modify norm no lost error
thermo {steps}
run {warm_up}
run {steps}
"""


@dataclass(frozen=True)
class Timing:
    """What a peer's run took: ``seconds`` of its time loop, and the state it ended in."""

    seconds: float
    contacts: float  # sphere-sphere
    kinetic_energy: float  # J, translation and rotation


def available(code: str) -> bool:
    """Whether the program and an MPI launcher are installed."""
    return bool(shutil.which(COMMANDS[code]) and shutil.which("mpirun"))


def run(code: str, bed: Bed, steps: int, warm_up: int, skin: float, ranks: int) -> Timing:
    """Time ``steps`` steps of ``code`` after ``warm_up`` untimed ones; ``skin`` in m."""
    with tempfile.TemporaryDirectory() as folder:
        write_input(code, bed, Path(folder), steps, warm_up, skin)
        command = [
            *("mpirun", "--allow-run-as-root", "--oversubscribe", "-np", str(ranks)),
            *(COMMANDS[code], "-in", "bed.in", "-log", "log", "-screen", "none"),
        ]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True
        )
        log = Path(folder, "log")
        text = log.read_text() if log.exists() else ""
    if done.returncode:
        raise RuntimeError(f"{code} failed:\n{text[-1000:]}{done.stderr[-1000:]}")
    return read_log(text)


def write_input(
    code: str, bed: Bed, folder: Path, steps: int, warm_up: int, skin: float
) -> None:
    """Write ``bed.in`` and ``bed.data``."""
    glass = beds.glass()
    numbers = {
        "skin": skin,
        "dt": beds.TIME_STEP,
        "young": glass.youngs_modulus,
        "poisson": glass.poissons_ratio,
        "restitution": beds.RESTITUTION,
        "friction": beds.FRICTION,
        "gravity": beds.GRAVITY,
        "steps": steps,
        "warm_up": warm_up,
    }
    if code == "liggghts":
        places = [("x", 0.0), ("x", bed.width), ("y", 0.0), ("y", bed.width), ("z", 0.0)]
        walls = [LIGGGHTS_WALL.format(k=k, axis=a, place=p) for k, (a, p) in enumerate(places)]
        text = LIGGGHTS
    else:
        numbers["model"] = LAMMPS_MODEL.format(**numbers)
        spans = [("x", 0.0, bed.width), ("y", 0.0, bed.width), ("z", 0.0, "NULL")]
        walls = [
            LAMMPS_WALL.format(k=k, axis=a, low=low, high=high, **numbers)
            for k, (a, low, high) in enumerate(spans)
        ]
        text = LAMMPS
    (folder / "bed.in").write_text((text + RUN).format(walls="\n".join(walls), **numbers))
    write_data(folder / "bed.data", bed, glass.density)


def write_data(path: Path, bed: Bed, density: float) -> None:
    """Write the spheres: id, type, diameter, density, x, y, z."""
    margin, top = beds.RADIUS, float(bed.position[:, 2].max()) + 10 * beds.RADIUS
    with open(path, "w") as file:
        file.write(f"settled bed\n\n{bed.count} atoms\n1 atom types\n\n")
        for axis in "xy":
            file.write(f"{-margin} {bed.width + margin} {axis}lo {axis}hi\n")
        file.write(f"{-margin} {top} zlo zhi\n\nAtoms\n\n")
        for k, (x, radius) in enumerate(zip(bed.position, bed.radius, strict=True), start=1):
            centre = " ".join(f"{value:.17g}" for value in x)
            file.write(f"{k} 1 {2 * radius:.17g} {density} {centre}\n")


def read_log(text: str) -> Timing:
    """Seconds of the last time loop and the last line of numbers before it."""
    seconds = float(re.findall(r"Loop time of (\S+)", text)[-1])
    table = text[: text.rindex("Loop time of")].strip().splitlines()[-1].split()
    _, _, moving, contacts, turning = map(float, table)
    return Timing(seconds, contacts / 2, moving + turning)
