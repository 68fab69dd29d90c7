"""Instructions of the compiled kernels of a scene, and the code as if an effect did not exist.

``python kernel_counts.py SCENE FOLDER``, in an environment of :func:`counts`, compiles a scene and
runs a few steps with each driver; the compiler leaves every kernel in FOLDER.
"""

import ast
import dataclasses
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FLAGS = {  # what the parts of the code that belong to an effect are compiled by
    "friction": {"rubs"},
    "rolling": {"rolls", "winds", "asks_reach", "asks_spin", "asks_inertia", "shares_inertia"},
    "rotation": {"rotates"},
    "history": {"has_history"},
    "adhesion": {"adhesion"},
    "multi-contact": {"spreads", "solves", "lags"},
    "dissipation": {"dissipates", "plastic"},
    "substrate coupling": {"coupled", "has_exchange"},
    "finite contact size": {"finite"},
    "extrapolated exchange": {"extrapolates"},
    "sleep": {"sleeps"},
    "lagged exchange": {"lagged"},
    "layer": {"layered"},
    "period": {"period"},
    "moving boundaries": {"moves", "any_moves"},
}
OF_POINTS = ("adhesion", "finite contact size", "lagged exchange", "layer", "period")
DRIVERS = ("serial", "team", "parallel")
TWO_THREADS = {"HALFSPACE_THREADS": "2", "HALFSPACE_BACKEND": "taichi"}
DUMPING = {"TI_PRINT_KERNEL_LLVM_IR_OPTIMIZED": "1", "TI_OFFLINE_CACHE": "0"}


class _Without(ast.NodeTransformer):
    """Takes out what is compiled only with one of ``flags``."""

    def __init__(self, flags):
        self.flags, self.taken = flags, 0

    def visit_If(self, node):
        self.generic_visit(node)
        if not self.flagged(node.test):
            return node
        self.taken += 1
        return node.body if "static(not " in ast.unparse(node.test) else node.orelse

    def visit_For(self, node):
        self.generic_visit(node)
        if not self.flagged(node.iter):
            return node
        self.taken += 1
        return []

    def flagged(self, node):
        """Whether the compiler decides it by one of the flags: ``ti.static(self.finite)``."""
        text = ast.unparse(node)
        return text.startswith("ti.static(") and re.findall(r"\w+", text)[-1] in self.flags

    def visit(self, node):
        node = super().visit(node)
        if isinstance(getattr(node, "body", None), list) and not node.body:
            node.body = [ast.Pass()]
        return node


def package_without(folder, effects):
    """A copy of the package in ``folder`` without the code of ``effects``; how many parts of it
    were taken out."""
    flags = set().union(*(FLAGS[effect] for effect in effects))
    shutil.copytree(ROOT / "taichi_dem", folder / "taichi_dem")
    taken = 0
    for path in sorted((folder / "taichi_dem").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        without = _Without(flags)
        tree = without.visit(ast.parse(source))
        if without.taken:
            path.write_text(ast.unparse(ast.fix_missing_locations(tree)), encoding="utf-8")
            taken += without.taken
    return taken


def counts(scene, folder, package=ROOT):
    """Name and instructions of each kernel, in the order of compilation."""
    folder.mkdir()
    paths = os.pathsep.join(map(str, (package, ROOT)))
    subprocess.run(
        [sys.executable, __file__, scene, folder],
        env={**os.environ, **TWO_THREADS, **DUMPING, "PYTHONPATH": paths},
        check=True,
        capture_output=True,
        text=True,
    )
    return [_counted(path.read_text()) for path in sorted(folder.glob("*.ll"))]


def _counted(text):
    """The name of a kernel, if it does anything, and the lines within its functions that are
    neither labels nor continued from the one before."""
    bodies = re.findall(r"^define .*?^}", text, re.DOTALL | re.MULTILINE)
    instructions = sum(len(re.findall(r"^  [^\s;\]]", body, re.MULTILINE)) for body in bodies)
    name = re.search(r"@([a-z_]+)_c?\d", bodies[0])[1] if bodies else ""
    return name, instructions


def scenes():
    """One with everything off, each effect alone, and all that go together but one."""
    import taichi_dem as dem

    glass = dem.Material("glass", density=2500, youngs_modulus=5e7, poissons_ratio=0.22)
    floor = dem.Plane((0, 0, 0), (0, 0, 1), glass)
    place = [[0, 0, 0.999e-3], [0, 0, 2.998e-3]]
    base = {
        "spheres": dem.Spheres(position=place, radius=1e-3, material=glass),
        "boundaries": [floor],
    }
    elastic, damped = dem.Hertz(1.0), dem.Hertz(0.5)
    rolls = dem.CDT(0.1, regularization="spring")
    presses = dem.Piston((0, 0, 3.9975e-3), (0, 0, -1), glass, velocity=0.01)
    soft = {"boundaries": [], "substrate": dem.Substrate(glass, coupling="point")}

    def scene(law, **rest):
        return dem.Scene(**{**base, "law": law, **rest})

    all_of_them = {
        "normal": damped,
        "tangential": dem.Mindlin(0.3),
        "rolling": rolls,
        "surface": dem.MultiContact(),
    }
    moved = {"boundaries": [floor, presses]}

    on_points = scene(
        dem.Law(damped, dem.Mindlin(0.3), rolls), boundaries=[presses], substrate=soft["substrate"]
    )
    creeping = dem.Substrate(glass, coupling="point", relaxation=dem.Relaxation(1e7, 0.1))
    on_layer = dem.Substrate(glass, coupling="point", layer=dem.Layer(0.1))

    def but(slot):
        return scene(dem.Law(**{name: law for name, law in all_of_them.items() if name != slot}))

    return {
        "plain": scene(dem.Law(elastic)),
        "friction": scene(dem.Law(elastic, dem.Mindlin(0.3, damping=0.0))),
        "rolling": scene(dem.Law(elastic, rolling=rolls)),
        "adhesion": scene(dem.Law(dem.JKR(restitution=1.0, work_of_adhesion=0.01))),
        "multi-contact": scene(dem.Law(elastic, surface=dem.MultiContact())),
        "dissipation": scene(dem.Law(damped)),
        "substrate coupling": scene(dem.Law(elastic), **soft),
        "extrapolated exchange": scene(
            dem.Law(elastic),
            boundaries=[],
            substrate=dataclasses.replace(soft["substrate"], exchange_every=4),
        ),
        "sleep": scene(dem.Law(elastic), sleep=True),
        "finite contact size": scene(
            dem.Law(elastic), boundaries=[], substrate=dem.Substrate(glass)
        ),
        "lagged exchange": scene(
            dem.Law(elastic),
            boundaries=[],
            substrate=dem.Substrate(glass, coupling="point", exchange="lagged"),
        ),
        "layer": scene(dem.Law(elastic), boundaries=[], substrate=on_layer),
        "relaxation": scene(dem.Law(elastic), boundaries=[], substrate=creeping),
        "period": scene(dem.Law(elastic), period=(8e-3, 9e-3)),
        "moving boundaries": scene(dem.Law(elastic), **moved),
        "all but friction": but("tangential"),
        "all but rolling": but("rolling"),
        "all but multi-contact": but("surface"),
        "all but substrate coupling": scene(
            dem.Law(dem.JKR(restitution=0.5, work_of_adhesion=0.01), dem.Mindlin(0.3), rolls),
            boundaries=[presses],
            substrate=dem.Substrate(glass, exchange="none"),
        ),
        "all but extrapolated exchange": scene(
            dem.Law(dem.JKR(restitution=0.5, work_of_adhesion=0.01), dem.Mindlin(0.3), rolls),
            boundaries=[presses],
            substrate=soft["substrate"],
        ),
        "all but adhesion": scene(
            dem.Law(damped, dem.Mindlin(0.3), rolls),
            boundaries=[presses],
            substrate=soft["substrate"],
        ),
        **dict.fromkeys([f"all but {effect}" for effect in OF_POINTS], on_points),
        "all but moving boundaries": scene(dem.Law(**all_of_them)),
    }


def main():
    import taichi_dem as dem

    name, folder = sys.argv[1:]
    scene = scenes()[name]
    os.chdir(folder)  # where the compiler leaves the kernels
    sim = dem.Simulation(scene, driver="serial")
    for driver in DRIVERS:
        sim._engine.pace.driver = driver  # without a look at whether its threads have cores
        sim._engine.advance(3)  # at once: a run is cut into pieces by the clock
    assert math.isfinite(sim.energy()["kinetic"])


if __name__ == "__main__":
    main()
