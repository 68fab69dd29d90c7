"""Imports point one way: every module belongs to a layer, and a layer knows only those below it."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("taichi_dem", "halfspace")

LAYERS = {
    "scene": "validation material shapes periodic overlaps packing sphere_files spheres substrate "
    "scene time_step writing tables toml_text run_plan reading scene_file scene_writer",
    "kernels": "types control particles effects contact_list grid neighbors boundaries geometry "
    "past expansions lagged_expansions reciprocal expansion_passes expansion_newton coefficients "
    "forces pair_sums coupled_contacts coupling lagged_surface doubts extrapolation ground_past "
    "ground_contacts exchange joint pressed creep members hosted lagged integrate meeting step "
    "drivers energy guards views sleep pace ground ground_view on_list good_state engine memory "
    "blocks",
    "simulation": "alerts asked schedule summary simulation moments neglect cost",
    "outputs": "style labels wording snapshot frames progress output bed dents plot",
    "tools": "streams folder run oddities check settings record accuracy orders closed_form "
    "worker workers study_point study_result study_plan study_picture study_report study_bench "
    "studies pilot choice asked_error cli __main__",
}
MAY_IMPORT = {
    "scene": {"scene"},
    "kernels": {"scene", "kernels"},
    "simulation": {"scene", "kernels", "simulation"},
    "outputs": {"scene", "outputs"},
    "tools": set(LAYERS),
}
LAYER_OF = {module: layer for layer, modules in LAYERS.items() for module in modules.split()}
LAZILY = {("scene_file", "contacts.law")}  # laws by name, where a file is read
HALFSPACE_IN = {
    "exchange": {"halfspace"},
    "ground_view": {"halfspace"},
    "hosted": {"halfspace"},
    "lagged": {"halfspace"},
    "creep": {"halfspace"},
    "pair_sums": {"halfspace.finite"},
    "types": {"halfspace.backend"},
    "engine": {"halfspace.backend"},
    "simulation": {"halfspace.backend"},
    "summary": {"halfspace.backend"},
}
LIGHT = {"numpy", "scipy"}  # what a module may import outright, the kernel compiler aside


def layer_of(module: str) -> str | None:
    return "kernels" if module.split(".")[0] == "contacts" else LAYER_OF.get(module)


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


FILES = {module_name(p): p for name in PACKAGES for p in sorted((ROOT / name).rglob("*.py"))}
MODULES = [
    name.removeprefix("taichi_dem.")
    for name in FILES
    if name.startswith("taichi_dem.") and not name.endswith("__init__")
]


def imports(name: str, outright: bool) -> Iterator[str]:
    """What a module imports, by full name; ``outright``: when it is imported itself, not later."""

    def visit(nodes: list[ast.stmt]) -> Iterator[ast.Import | ast.ImportFrom]:
        for node in nodes:
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                yield node
            elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                continue
            elif not (outright and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))):
                for part in ("body", "orelse", "finalbody", "handlers"):
                    yield from visit(getattr(node, part, []))

    for node in visit(ast.parse(FILES[name].read_text(encoding="utf-8")).body):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            continue
        parent = name.split(".")[: -node.level] if node.level else []
        base = ".".join([*parent, *filter(None, [node.module])])
        for alias in node.names:
            inner = f"{base}.{alias.name}"
            yield inner if inner in FILES else base


def loaded_after(statement: str) -> set[str]:
    code = f"import sys; {statement}; print('LOADED', *sys.modules)"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, check=True, env=env).stdout
    return set(out.rpartition("LOADED")[2].split())


@pytest.mark.parametrize("module", MODULES)
def test_a_module_knows_its_own_layer_and_those_below(module):
    layer = layer_of(module)
    assert layer, f"taichi_dem/{module}.py: say in LAYERS where it belongs"
    for other in imports(f"taichi_dem.{module}", outright=False):
        if other.startswith("taichi_dem."):
            other = other.removeprefix("taichi_dem.")
            below = other == "contacts" or layer_of(other) in MAY_IMPORT[layer]
            assert below or (module, other) in LAZILY, f"{module} imports {other}"


@pytest.mark.parametrize("module", MODULES)
def test_the_half_space_is_asked_in_one_place(module):
    used = {name for name in imports(f"taichi_dem.{module}", False) if name.startswith("halfspace")}
    assert used <= HALFSPACE_IN.get(module, set())


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("halfspace.")])
def test_the_half_space_knows_nothing_of_particles(name):
    used = {other.split(".")[0] for other in imports(name, outright=False)}
    more = {"halfspace.mesh": {"taichi", "quadrants"}, "halfspace.pictures": {"matplotlib"}}
    assert used <= set(sys.stdlib_module_names) | LIGHT | {"halfspace"} | more.get(name, set())


@pytest.mark.parametrize("name", FILES)
def test_heavy_libraries_wait_until_they_are_used(name):
    used = {other.split(".")[0] for other in imports(name, outright=True)}
    own = set(sys.stdlib_module_names) | set(PACKAGES) | {"tomli", "tomllib"}
    assert used <= own | LIGHT


def test_no_module_needs_one_that_needs_it():
    needs = {name: set(imports(name, outright=True)) & set(FILES) - {name} for name in FILES}
    while free := [name for name, others in needs.items() if not others]:
        for name in free:
            del needs[name]
        needs = {name: others - set(free) for name, others in needs.items()}
    assert not needs


def test_importing_the_package_costs_nothing():
    assert not loaded_after("import taichi_dem") & {"numpy", "scipy", "taichi", "quadrants"}


def test_scenes_outputs_and_pictures_start_no_compiler():
    modules = [m for layer in ("scene", "outputs") for m in LAYERS[layer].split()]
    loaded = loaded_after("; ".join(f"import taichi_dem.{m}" for m in modules))
    assert "taichi_dem.plot" in loaded
    assert not loaded & {"taichi", "quadrants", "matplotlib", "vtkmodules", "tqdm"}


def test_every_public_name_is_where_the_package_says():
    import taichi_dem

    for name in taichi_dem.__all__:
        assert getattr(taichi_dem, name).__name__ == name
    with pytest.raises(AttributeError, match="Nonsense"):
        _ = taichi_dem.Nonsense


def test_a_simulation_starts_without_what_only_some_need():
    """SciPy takes longer to import than a scene of a few hundred spheres to be checked."""
    assert "scipy" not in loaded_after("import taichi_dem; taichi_dem.Simulation")
