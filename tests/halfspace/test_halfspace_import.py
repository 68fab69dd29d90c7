"""What `import halfspace` brings, and what it must not."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import halfspace


def modules_after(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(' '.join(sys.modules))"
    env = {**os.environ, "PYTHONPATH": str(Path(halfspace.__file__).parents[1])}
    command = [sys.executable, "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    return {name.split(".")[0] for name in out.stdout.split()}


def test_import_and_solve_start_neither_taichi_nor_the_particles():
    use = (
        "import halfspace; import halfspace.reference as r; "
        "g = halfspace.HalfSpace(1.0, 0.3); "
        "halfspace.solve(g, [[0, 0], [1, 0]], [0.1, 0.1], r.hertz_law(1.0, 1.0)); "
        "g.field([[0, 0]], [1], [[1, 1]])"
    )
    loaded = modules_after(use)
    assert "halfspace" in loaded
    assert not loaded & {"taichi", "quadrants", "taichi_dem", "matplotlib"}


def test_import_alone_leaves_scipy_out():
    assert "scipy" not in modules_after("import halfspace")


def test_the_mesh_alone_knows_the_compiler():
    """And what only the mesh imports; PyTorch is nobody's."""
    folder = Path(halfspace.__file__).parent
    knowing = {
        path.stem
        for path in folder.glob("*.py")
        if re.search(
            r"^\s*(from \.(backend|mesh_\w+) |from \. import .*mesh)", path.read_text(), re.M
        )
    }
    assert knowing == {"mesh", "mesh_kernels", "mesh_pairs", "mesh_sizes"}
    assert not any(re.search(r"import torch", path.read_text()) for path in folder.glob("*.py"))


def test_public_names():
    for name in halfspace.__all__:
        assert getattr(halfspace, name) is not None
    assert callable(halfspace.solve)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = halfspace.nonsense
