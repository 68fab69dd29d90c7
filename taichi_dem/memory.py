"""What the fields of a simulation occupy, counted from the fields themselves."""

from __future__ import annotations

import math
from typing import Any

from taichi_dem.engine import Engine
from taichi_dem.grid import CELLS, Grid
from taichi_dem.types import ti


def memory(engine: Engine) -> dict[str, int]:
    """Bytes by part, as they are now; the contact list may grow later."""
    grid = engine.grid
    parts = {
        "particles": fields(engine.particles),
        "contact list": fields(engine.contacts),
        "cells": fields(grid) if grid.dense else sparse(grid),
        "boundaries": fields(engine.boundaries),
    }
    if engine.exchange is not None:
        parts["substrate"] = fields(engine.exchange) + fields(engine.exchange.solver)
    return parts


def fields(owner: Any) -> int:
    """Bytes of the fields that are attributes of ``owner``."""
    return sum(size(value) for value in vars(owner).values() if isinstance(value, ti.Field))


def size(field: Any) -> int:
    """Bytes of one field: scalar, vector or struct."""
    if hasattr(field, "keys"):
        return sum(size(field.get_member_field(name)) for name in field.keys)
    components = getattr(field, "n", 1) * getattr(field, "m", 1)
    return math.prod(field.shape) * components * int(str(field.dtype)[1:]) // 8


def sparse(grid: Grid) -> int:
    """Bytes of a grid whose blocks exist only where they are occupied."""
    whole = size(grid.block_population) + size(grid.population) + size(grid.end)
    pointers = 8 * math.prod(grid.block_population.shape)
    block = size(grid.block_population) // math.prod(grid.block_population.shape)
    block += CELLS * (size(grid.population) + size(grid.end)) // math.prod(grid.end.shape)
    return fields(grid) - whole + pointers + int(grid.occupied_count[0]) * block
