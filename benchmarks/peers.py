"""The settled bed in LIGGGHTS and LAMMPS: timed runs, and what their logs say of the end.

Both read the same data file and take the same laws: Hertz, a Mindlin spring with history, Coulomb
friction, and the dashpot of Tsuji et al. that gives a constant restitution.
"""

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import taichi_dem as dem
from benchmarks import lammps, liggghts

BINARIES = {"liggghts": "liggghts", "lammps": "lmp"}
LAUNCHER = ("mpirun", "--allow-run-as-root", "--oversubscribe")

# thermo_modify comes after thermo_style, which sets its own
WATCHED = """\
compute touching all contact/atom
compute total all reduce sum c_touching
compute turning all erotate/sphere
thermo_style custom step atoms ke c_total c_turning
thermo_modify norm no lost error
"""


@dataclass(frozen=True)
class Timing:
    """What a peer's run took: ``seconds`` of its time loop, and the state it ended in."""

    seconds: float
    contacts: float  # sphere-sphere
    kinetic_energy: float  # J, translation and rotation


def available(code: str) -> bool:
    """Whether the program and an MPI launcher are installed."""
    return bool(shutil.which(BINARIES[code]) and shutil.which(LAUNCHER[0]))


def run(
    code: str, scene: dem.Scene, dt: float, steps: int, warm_up: int, skin: float, ranks: int
) -> Timing:
    """Time ``steps`` steps of ``code`` after ``warm_up`` untimed ones; ``skin`` in m."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = folder / liggghts.SCRIPT
        if code == "liggghts":
            liggghts.write(folder, scene, dt=dt, steps=warm_up, skin=skin)
        else:
            liggghts.write_data(folder / liggghts.DATA, scene)
            script.write_text(lammps.script(scene, dt, warm_up, skin))
        with script.open("a") as file:
            file.write(f"{WATCHED}thermo {steps}\nrun {steps}\n")
        command = [*LAUNCHER, "-np", str(ranks), BINARIES[code], "-in", script.name]
        command += ["-log", liggghts.LOG, "-screen", "none"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        log = folder / liggghts.LOG
        text = log.read_text() if log.exists() else ""
    if done.returncode:
        raise RuntimeError(f"{code} failed:\n{text[-1000:]}{done.stderr[-1000:]}")
    return read_log(text)


def read_log(text: str) -> Timing:
    """Seconds of the last time loop, and the last line of numbers before it."""
    seconds = float(re.findall(r"Loop time of (\S+)", text)[-1])
    table = text[: text.rindex("Loop time of")].strip().splitlines()
    _, _, moving, contacts, turning = map(float, table[-1].split())
    return Timing(seconds, contacts / 2, moving + turning)
