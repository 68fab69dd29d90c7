"""The list of all keys of a scene file is complete."""

import importlib.util
from pathlib import Path

PATH = Path(__file__).parents[2] / "docs" / "scene_keys.py"


def test_every_key_is_listed_as_it_is():
    spec = importlib.util.spec_from_file_location("scene_keys", PATH)
    scene_keys = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scene_keys)
    page = scene_keys.PAGE.read_text(encoding="utf-8")
    assert scene_keys.with_tables(page) == page, "run python docs/scene_keys.py --write"
    for key in ("`retardation_time`", "`volume_fraction`", "`lammps_data`", "`effect_costs`"):
        assert key in page
